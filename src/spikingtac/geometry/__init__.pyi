"""Public names of geometry by touch."""

# Holes
from .hole import FRICTION as FRICTION
from .hole import SLIP_SIGMA as SLIP_SIGMA
from .hole import Circle as Circle
from .hole import estimate_hole as estimate_hole
from .hole import fit_circle as fit_circle
from .travel import MEAN_REACH_MM as MEAN_REACH_MM
from .travel import REACH_SIGMA_MM as REACH_SIGMA_MM
from .travel import TravelModel as TravelModel
from .travel import fit_travel as fit_travel
from .travel import hexagon_reach_mm as hexagon_reach_mm
