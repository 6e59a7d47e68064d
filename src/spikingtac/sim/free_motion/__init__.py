"""Contact-free motion: a probe that vibrates with the arm, computed where events are due."""
