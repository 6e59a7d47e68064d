"""Quantities of the displacement field: gradients, strain, shear, torsion."""
