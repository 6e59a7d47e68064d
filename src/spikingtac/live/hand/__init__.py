"""Many fingers on one machine: a process for each sensor, its tracks in shared memory."""
