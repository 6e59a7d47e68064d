"""Which part of the skin a body touches, from the displacement of the markers."""
