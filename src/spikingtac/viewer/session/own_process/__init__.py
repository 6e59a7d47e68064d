"""What runs in the session's own process."""
