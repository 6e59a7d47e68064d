"""Tables of events: text, NumPy arrays, HDF5."""
