"""The command line: one verb per file, without logic of the library."""
