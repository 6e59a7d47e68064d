"""Live operation: the pipeline in a process of its own, and what it shares with the others."""
