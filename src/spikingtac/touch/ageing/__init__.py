"""Whether the gel still looks as it did when it was calibrated."""
