"""Public names of contact detection."""

# Windows of events
from .detector import WINDOW_US as WINDOW_US
from .detector import Window as Window
from .detector import count_of as count_of
from .detector import packets_of as packets_of
from .recording import LEAST_QUIET_WINDOWS as LEAST_QUIET_WINDOWS
from .recording import come_in_bursts as come_in_bursts
from .recording import find_contacts as find_contacts
from .recording import leading_quiet as leading_quiet
from .recording import paired_windows as paired_windows
from .recording import quietest as quietest

# Detectors
from .detector import ContactDetector as ContactDetector
from .detector import DetectorSummary as DetectorSummary
from .registry import DETECTORS as DETECTORS
from .registry import DetectionConfig as DetectionConfig
from .registry import detectors as detectors
from .registry import make_detector as make_detector
from .registry import EventCountDetector as EventCountDetector
from .detector import QuietStatistics as QuietStatistics
from .sequential_detector import SequentialMotionDetector as SequentialMotionDetector
from .registry import SelfCalibratingDetector as SelfCalibratingDetector
