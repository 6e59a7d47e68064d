"""Public names of the room ``batch``."""

from .run import begin_run as begin_run
