"""A calibration in a process of its own, so that the page goes on meanwhile."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.source import EventSource, PacketSource
from spikingtac.markers.calibration.calibrate import CalibrationConfig, calibrate
from spikingtac.stream.host import Asker, Factory, Host, closed_by
from spikingtac.types import EventPacket

COLUMNS = ("x", "y", "p", "t")
RESULT_NAME = "result.json"


class CalibrationRun:
    """Calibrates from events, in another process.

    Args:
        open_source: Opens the events, there.
        config: What the calibration is told.
        scratch: A folder of this run's own; it is removed at :meth:`close`.
    """

    def __init__(
        self,
        open_source: Factory[EventSource],
        config: CalibrationConfig,
        scratch: tempfile.TemporaryDirectory[str],
    ) -> None:
        self._scratch = scratch
        given = {"open_source": open_source, "config": config, "folder": scratch.name}
        self._host = Host(Factory(function=_calibrate, arguments=given))

    def poll(self) -> Calibration | str | None:
        """Return the calibration, or why there is none; None while it is computed."""
        try:
            done = self._host.receive()
        except EOFError:
            return str(closed_by(self._host, "the calibration"))
        except Exception as error:  # told by the page
            return str(error)
        return None if done is None else Calibration.load(self._scratch_file)

    def close(self) -> None:
        """End the run, and remove what it wrote."""
        self._host.close()
        self._scratch.cleanup()

    @property
    def _scratch_file(self) -> Path:
        return Path(self._scratch.name) / RESULT_NAME


def stored(events: EventPacket, folder: str) -> Factory[EventSource]:
    """Write events into a folder, and return what opens them again in another process."""
    for name in COLUMNS:
        np.save(Path(folder) / f"{name}.npy", getattr(events, name))
    span_us = (events.t_start_us, events.t_end_us)
    return Factory(
        function=open_stored,
        arguments={"folder": folder, "span_us": span_us, "size": events.size},
    )


def open_stored(folder: str, span_us: tuple[int, int], size: tuple[int, int]) -> PacketSource:
    """Open what :func:`stored` wrote."""
    x, y, p, t = (np.load(Path(folder) / f"{name}.npy", mmap_mode="r") for name in COLUMNS)
    return PacketSource([EventPacket(x, y, p, t, *span_us, size)], size)


def _calibrate(
    asker: Asker, open_source: Factory[EventSource], config: CalibrationConfig, folder: str
) -> None:
    calibrate(open_source(), config).save(Path(folder) / RESULT_NAME)
    asker.tell(True)
