"""Two fingers on one page."""
