"""Training of the network without labels."""
