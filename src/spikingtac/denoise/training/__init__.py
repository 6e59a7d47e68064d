"""Train the network without labels."""
