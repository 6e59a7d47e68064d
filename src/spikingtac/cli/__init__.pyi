"""Public names of the room ``cli``."""

from .recordings import check_workers as check_workers
from .messages import Table as Table
from .messages import progress as progress
from .messages import tell as tell
from .options import WriteArgs as WriteArgs
