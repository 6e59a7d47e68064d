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
from .markers.calibration.calibrate import CalibrationConfig as CalibrationConfig
from .markers.calibration.calibrate import calibrate as calibrate

# Tracking: events in, marker displacements out
from .config import Config as Config
from .config import load_config as load_config
from .markers.registry import make_tracker as make_tracker
from .markers.tracker import MarkerTracker as MarkerTracker
from .pipeline.follow import follow as follow
from .types import MarkerFrame as MarkerFrame
from .tracks import Tracks as Tracks
from .tracks.comparison import compare_tracks as compare_tracks
from .tracks.comparison import compare_with_truth as compare_with_truth

# Live: sensors on a camera
from .stream.live import live as live
from .stream.live import Live as Live
from .stream.live import Hand as Hand
from .stream.live import Finger as Finger

# Contact, from raw events at 1 kHz
from .types import Contact as Contact
from .contact.detector import ContactDetector as ContactDetector
from .contact.registry import DetectionConfig as DetectionConfig
from .contact.event_count import EventCountConfig as EventCountConfig
from .contact.event_count import EventCountDetector as EventCountDetector
from .contact.quiet import QuietStatistics as QuietStatistics
from .contact.motion.sequential_detector import SequentialMotionDetector as SequentialMotionDetector
from .contact.registry import make_detector as make_detector

# Robot
from .types import Pose as Pose

# Digital twin
from .sim.scene.source import SceneSource as SceneSource
from .sim import load_scene as load_scene
from .sim.scene.render import simulate as simulate

# Figures
from .plots.tracks import plot_tracks as plot_tracks

# Errors
from .errors import SpikingTacError as SpikingTacError

__version__: str
