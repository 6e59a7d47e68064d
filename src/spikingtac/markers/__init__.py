"""From the state map to the displacement field (paper sections IV-B to IV-D)."""
