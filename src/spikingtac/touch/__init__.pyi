"""Public names of the room ``touch``."""

# Touches and slip
from .slip.held import HeldTouch as HeldTouch
from .slip.held import HeldTouchDetector as HeldTouchDetector
from .slip.held import find_slip as find_slip
from .slip.held import find_touches as find_touches
from .slip.monitor import SlipMonitor as SlipMonitor
from .slip.monitor import Slip as Slip
from .slip.monitor import SlipState as SlipState
from .detector import TouchDetector as TouchDetector
from .touch import Touch as Touch

# The displacement field
from .field import FieldGauge as FieldGauge
from .patch import Patch as Patch
from .patch import PatchEstimator as PatchEstimator
from .vibration import Spectrum as Spectrum
from .vibration import VibrationMonitor as VibrationMonitor

# Forces
from .force.fit import ForceScore as ForceScore
from .force.fit import fit_force as fit_force
from .force.fit import score_force as score_force
from .force.model import ForceEstimator as ForceEstimator
from .force.model import ForceModel as ForceModel
from .force.model import Wrench as Wrench
from .force.model import load_force as load_force
from .force.regression import r_squared as r_squared
from .series import WrenchSeries as WrenchSeries
from .series import load_series as load_series
from .elastic import SkinConfig as SkinConfig
from .elastic import synthetic_series as synthetic_series

# What the experiments use besides
from .network import OPSET as OPSET
from .network import with_record as with_record
