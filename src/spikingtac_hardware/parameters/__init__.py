"""The parameters of a design, one file for each kind of part."""
