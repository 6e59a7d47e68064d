"""Public names of arms and closed loops."""

# Arms
from .arm import Arm as Arm
from .arm import ArmState as ArmState
from .ur import open_arm as open_arm
from .ur import URArm as URArm
from .robotiq import Grip as Grip
from .robotiq import RobotiqGripper as RobotiqGripper

# Watchdog
from .watchdog import Health as Health
from .watchdog import Watchdog as Watchdog
from .watchdog import WatchdogThread as WatchdogThread

# The guard of an arm, in a process of its own
from .guard import ContactProcess as ContactProcess
from .guard_loop import stream_arrivals as stream_arrivals

# Closed loops: move until contact, search a hole
from .approacher import CRUISE_TOLERANCE as CRUISE_TOLERANCE
from .approacher import Approach as Approach
from .approacher import ApproachConfig as ApproachConfig
from .approacher import approach as approach
from .prober import ArmProber as ArmProber
from .prober import Prober as Prober
from .prober import ProbingConfig as ProbingConfig
from .prober import Touched as Touched
from .adaptive_search import FoundHole as FoundHole
from .adaptive_search import hole_around as hole_around
from .adaptive_search import probe_hole as probe_hole
from .adaptive_search import LEAST_FREE_MM as LEAST_FREE_MM
from .adaptive_search import require_room as require_room
