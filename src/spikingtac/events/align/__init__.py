"""Several clocks on one time base: maps with their errors, sources and poses that follow them."""
