"""Event-camera tactile sensing: from raw events to marker displacements and contacts.

The names below are imported when they are first used, so that ``import spikingtac`` costs a few
milliseconds and loads neither NumPy nor Numba nor SciPy nor Matplotlib.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from spikingtac.kernel_cache import provide_kernel_cache

if TYPE_CHECKING:
    __version__: str
    from spikingtac.calibration.sensor_calibration import Calibration as Calibration
    from spikingtac.config import Config as Config
    from spikingtac.config import load_config as load_config
    from spikingtac.contact.detector import ContactDetector as ContactDetector
    from spikingtac.contact.event_count import EventCountConfig as EventCountConfig
    from spikingtac.contact.event_count import EventCountDetector as EventCountDetector
    from spikingtac.contact.motion.sequential_detector import (
        SequentialMotionDetector as SequentialMotionDetector,
    )
    from spikingtac.contact.quiet import QuietStatistics as QuietStatistics
    from spikingtac.contact.registry import DetectionConfig as DetectionConfig
    from spikingtac.contact.registry import make_detector as make_detector
    from spikingtac.errors import SpikingTacError as SpikingTacError
    from spikingtac.events.create import create_events as create_events
    from spikingtac.events.open import open_events as open_events
    from spikingtac.events.recording import Recording as Recording
    from spikingtac.events.source import EventSource as EventSource
    from spikingtac.events.source import PacketSource as PacketSource
    from spikingtac.events.windows import windows as windows
    from spikingtac.markers.calibration.calibrate import CalibrationConfig as CalibrationConfig
    from spikingtac.markers.calibration.calibrate import calibrate as calibrate
    from spikingtac.markers.registry import make_tracker as make_tracker
    from spikingtac.markers.tracker import MarkerTracker as MarkerTracker
    from spikingtac.pipeline.follow import follow as follow
    from spikingtac.plots.tracks import plot_tracks as plot_tracks
    from spikingtac.sim.scene.catalog import load as load_scene  # noqa: F401 - renamed on purpose
    from spikingtac.sim.scene.render import simulate as simulate
    from spikingtac.sim.scene.source import SceneSource as SceneSource
    from spikingtac.stream.live import Finger as Finger
    from spikingtac.stream.live import Hand as Hand
    from spikingtac.stream.live import Live as Live
    from spikingtac.stream.live import live as live
    from spikingtac.tracks import Tracks as Tracks
    from spikingtac.tracks.comparison import compare_tracks as compare_tracks
    from spikingtac.tracks.comparison import compare_with_truth as compare_with_truth
    from spikingtac.types import Contact as Contact
    from spikingtac.types import EventPacket as EventPacket
    from spikingtac.types import LossCounters as LossCounters
    from spikingtac.types import MarkerFrame as MarkerFrame
    from spikingtac.types import Pose as Pose

_HOMES = {
    "Calibration": "calibration.sensor_calibration",
    "CalibrationConfig": "markers.calibration.calibrate",
    "Config": "config",
    "Contact": "types",
    "ContactDetector": "contact.detector",
    "DetectionConfig": "contact.registry",
    "EventCountConfig": "contact.event_count",
    "EventCountDetector": "contact.event_count",
    "EventPacket": "types",
    "EventSource": "events.source",
    "Finger": "stream.live",
    "Hand": "stream.live",
    "Live": "stream.live",
    "LossCounters": "types",
    "MarkerFrame": "types",
    "MarkerTracker": "markers.tracker",
    "PacketSource": "events.source",
    "Pose": "types",
    "QuietStatistics": "contact.quiet",
    "Recording": "events.recording",
    "SceneSource": "sim.scene.source",
    "SequentialMotionDetector": "contact.motion.sequential_detector",
    "SpikingTacError": "errors",
    "Tracks": "tracks",
    "compare_tracks": "tracks.comparison",
    "compare_with_truth": "tracks.comparison",
    "calibrate": "markers.calibration.calibrate",
    "create_events": "events.create",
    "follow": "pipeline.follow",
    "live": "stream.live",
    "load_config": "config",
    "load_scene": "sim.scene.catalog:load",
    "make_detector": "contact.registry",
    "make_tracker": "markers.registry",
    "open_events": "events.open",
    "plot_tracks": "plots.tracks",
    "simulate": "sim.scene.render",
    "windows": "events.windows",
}
"""Public name -> the module that defines it, and after a colon its name there if it differs."""

__all__ = ["__version__", *sorted(_HOMES)]  # pyright: ignore[reportUnsupportedDunderAll]

provide_kernel_cache()


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name == "__version__":
        value: Any = importlib.import_module("spikingtac._version").package_version()
    elif name in _HOMES:
        module, _, original = _HOMES[name].partition(":")
        value = getattr(importlib.import_module(f"spikingtac.{module}"), original or name)
    else:
        raise AttributeError(f"module 'spikingtac' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names only, imported or not."""
    return list(__all__)
