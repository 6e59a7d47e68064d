"""One codec a file: EVT2, EVT2.1, EVT3, NPZ, CSV, ES, AEDAT4, HDF5, ROS bags."""
