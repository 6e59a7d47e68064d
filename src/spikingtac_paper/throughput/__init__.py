"""The throughput bench, beside tuned peers."""
