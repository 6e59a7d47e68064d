"""What every experiment needs: worker processes, run folders, rows, reports."""
