"""Public names of the room ``state_map``."""

from .binary import BinaryStateMap as BinaryStateMap
from .binary import StateMap as StateMap
from .binary import paint_binary_discs as paint_binary_discs
from .binary import paint_discs as paint_discs
from .graded import GradedStateMap as GradedStateMap
