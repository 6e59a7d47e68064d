"""Public names of the room ``markers``."""

from .blobs import UNMATCHED as UNMATCHED
from .blobs import associate as associate
from .blobs import blob_areas_px as blob_areas_px
from .blobs import find_blobs as find_blobs
from .laws import AnchoredLaw as AnchoredLaw
from .laws import OutputLaw as OutputLaw
from .laws import PaperLaw as PaperLaw
from .laws import PaperLawConfig as PaperLawConfig
from .neighbours import smallest_spacing_px as smallest_spacing_px
from .paper import BlobTracker as BlobTracker
from .paper import BlobTrackerConfig as BlobTrackerConfig
from .paper import PROXIMITY_SHARE as PROXIMITY_SHARE
from .paper import painted_binary_map as painted_binary_map
from .registry import TRACKERS as TRACKERS
from .registry import trackers as trackers
