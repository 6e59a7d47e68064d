"""From a noisy state map to a clean one (paper section IV-B)."""
