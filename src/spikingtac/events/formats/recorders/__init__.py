"""Files of other people's recorders that are neither a format of a maker nor ours."""
