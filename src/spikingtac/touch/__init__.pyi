"""Public names of the room ``touch``."""

from .contact_patch.patch import Patch as Patch
from .contact_patch.patch import SQUARE as SQUARE
from .contact_patch.patch import patch_of_cells as patch_of_cells
from .elastic.surface_response import SkinConfig as SkinConfig
from .elastic.synthetic_contacts import synthetic_series as synthetic_series
from .field.local_gradient import GradientOperator as GradientOperator
from .force.creep_memory import CreepConfig as CreepConfig
from .force.creep_memory import CreepMemory as CreepMemory
from .force.files.series_file import load_series as load_series
from .force.fit import fit_force as fit_force
from .force.score import r_squared as r_squared
from .force.wrench_series import WrenchSeries as WrenchSeries
from .slip.monitor import SlipMonitor as SlipMonitor
from .touches.detector import TouchDetector as TouchDetector
from .touches.touch import Touch as Touch
