"""Public names of the room ``batch``."""

from .run_folder import begin_run as begin_run
