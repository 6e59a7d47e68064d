"""What every reader checks: columns, the course of time, and what an input may claim."""
