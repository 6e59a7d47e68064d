"""Files that a session leaves: GIF, MCAP, Rerun, pictures, tables."""
