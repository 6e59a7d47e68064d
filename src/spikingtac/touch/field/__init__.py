"""What the field of displacements says: gradients, strain, shear, torsion."""
