"""Live operation: sensors in processes of their own, an arm's guard, one host and ring for all."""
