"""Public names of the room ``events``."""

from .address import Address as Address
from .camera_source import CameraSource as CameraSource
from .create import create_events as create_events
from .filters import BackgroundActivityFilter as BackgroundActivityFilter
from .formats.array_file import load_arrays as load_arrays
from .formats.file_source import ReadOptions as ReadOptions
from .hot_pixels import HotPixelFilter as HotPixelFilter
from .manifest import MANIFEST as MANIFEST
from .manifest import TRUTH as TRUTH
from .open import open_events as open_events
from .recording import Recording as Recording
from .recording import RecordingWriter as RecordingWriter
from .source import EventSource as EventSource
from .source import PacketSource as PacketSource
