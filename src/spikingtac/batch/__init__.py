"""Many recordings: workers, a journal that is resumed, a table of all results, a report."""
