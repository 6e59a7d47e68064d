"""Public names of the room ``cli``."""

from .recordings import check_workers as check_workers
from .messages import emit_json as emit_json
from .messages import emit_table as emit_table
from .messages import progress as progress
from .messages import remark as remark
