"""Public names of the room ``state_map``."""

from .binary import BinaryStateMap as BinaryStateMap
from .graded import GradedStateMap as GradedStateMap
from .paint import paint_binary_discs as paint_binary_discs
from .paint import paint_discs as paint_discs
from .state_map import StateMap as StateMap
