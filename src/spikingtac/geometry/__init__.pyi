"""Public names of geometry by touch."""

# Holes
from .hole import Circle as Circle
from .hole import Compensation as Compensation
from .hole import HoleFitConfig as HoleFitConfig
from .hole import fit_circle as fit_circle
from .hole import hexagon_reach_mm as hexagon_reach_mm
from .hole import mean_hexagon_reach_mm as mean_hexagon_reach_mm
from .touch_fit import TouchFitConfig as TouchFitConfig
from .touch_fit import estimate_hole as estimate_hole
from .travel import TravelModel as TravelModel
from .travel import fit_travel as fit_travel
