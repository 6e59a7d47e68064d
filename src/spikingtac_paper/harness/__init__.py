"""The common parts of all experiments: worker processes, run folders, rows, reports."""
