"""The wrench of a live sensor, one field at a time."""
