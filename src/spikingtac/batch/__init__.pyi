"""Public names of the room ``batch``."""

from .run import begin_run as begin_run
from .run import write_rows as write_rows
