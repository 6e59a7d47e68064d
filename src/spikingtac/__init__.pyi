"""Public names of the package; each is imported when it is first used."""

# Events: recordings, cameras, packets
from .events.open import open_events as open_events
from .events.create import create_events as create_events
from .events.windows import windows as windows
from .events.recording import Recording as Recording
from .types import EventPacket as EventPacket
from .events.source import EventSource as EventSource
from .events.source import PacketSource as PacketSource
from .types import LossCounters as LossCounters

# Calibration
from .calibration.sensor_calibration import Calibration as Calibration
from .markers.calibration.calibrate import calibrate as calibrate
from .markers.calibration.find_markers import CalibrationConfig as CalibrationConfig

# Tracking: events in, marker displacements out
from .pipeline.track import track as track
from .config import Config as Config
from .config import load_config as load_config
from .markers.registry import make_tracker as make_tracker
from .markers.registry import MarkerTracker as MarkerTracker
from .pipeline.follow import follow as follow
from .types import MarkerFrame as MarkerFrame
from .tracks import Tracks as Tracks
from .tracks.comparison import compare_tracks as compare_tracks
from .tracks.comparison import compare_with_truth as compare_with_truth

# Live: sensors on a camera
from .stream.live import live as live
from .stream.live import Live as Live

# Contact, from raw events at 1 kHz
from .types import Contact as Contact
from .contact.detector import ContactDetector as ContactDetector
from .contact.registry import DetectionConfig as DetectionConfig
from .contact.registry import EventCountDetector as EventCountDetector
from .contact.detector import QuietStatistics as QuietStatistics
from .contact.sequential_detector import SequentialMotionDetector as SequentialMotionDetector
from .contact.registry import make_detector as make_detector

# Touches, slip, forces
from .touch import find_touches as find_touches
from .touch import find_slip as find_slip
from .touch import fit_force as fit_force
from .touch import load_force as load_force
from .touch import HeldTouch as HeldTouch
from .touch import Slip as Slip
from .touch import ForceModel as ForceModel
from .touch import WrenchSeries as WrenchSeries

# Robot: arms, move until contact, search a hole
from .types import Pose as Pose
from .robot.approacher import Approach as Approach
from .robot.approacher import ApproachConfig as ApproachConfig
from .robot.approacher import approach as approach
from .robot.ur import open_arm as open_arm
from .robot.prober import ArmProber as ArmProber
from .robot.prober import ProbingConfig as ProbingConfig
from .robot.adaptive_search import FoundHole as FoundHole
from .robot.adaptive_search import probe_hole as probe_hole
from .geometry.travel import TravelModel as TravelModel
from .geometry.travel import fit_travel as fit_travel

# Digital twin
from .sim.source import SceneSource as SceneSource
from .sim import load_scene as load_scene
from .sim.render import simulate as simulate

# Figures
from .plots.tracks import plot_tracks as plot_tracks

# Errors
from .errors import SpikingTacError as SpikingTacError
from .errors import RecordingError as RecordingError
from .errors import CalibrationError as CalibrationError
from .errors import ConfigError as ConfigError
from .errors import DeviceError as DeviceError

__version__: str
