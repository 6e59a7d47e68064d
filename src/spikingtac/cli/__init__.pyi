"""Public names of the room ``cli``."""

from .messages import Table as Table
from .messages import progress as progress
from .messages import tell as tell
from .options import WriteArgs as WriteArgs
