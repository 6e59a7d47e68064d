"""One configuration from the stages' own: presets, strict TOML, and the digest of what was used."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from spikingtac.contact.registry import DetectionConfig
from spikingtac.markers.registry import TrackingConfig
from spikingtac.schema import from_toml, stored_file, to_mapping

PRESETS = ("default", "fast", "paper")  # Named configurations, as package data under ``configs/``.


@dataclass(frozen=True, kw_only=True, slots=True)
class Config:
    """All settings of the pipeline.

    Attributes:
        tracking: How markers are followed.
        contact: How contacts are detected.
    """

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    contact: DetectionConfig = field(default_factory=DetectionConfig)

    def with_tracking(self, **changes: Any) -> Config:
        """Return a copy with some fields of :attr:`tracking` changed; None changes nothing."""
        kept = {name: value for name, value in changes.items() if value is not None}
        return replace(self, tracking=replace(self.tracking, **kept))


def load_config(name: str | Path) -> Config:
    """Load a preset by name, or a TOML file by path.

    Raises:
        ConfigError: There is neither; SettingsFileError where the file holds an unknown key or an
            unfit value.
    """
    folder = Path(str(resources.files("spikingtac") / "configs"))
    return from_toml(Config, stored_file(name, folder, PRESETS, "preset"))


def digest(value: Any) -> str:
    """Return the sha256 of a resolved configuration, scene or document (first 16 digits)."""
    text = json.dumps(to_mapping(value), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
