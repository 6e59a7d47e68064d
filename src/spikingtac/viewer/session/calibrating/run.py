"""A calibration in a process of its own, so that the page goes on meanwhile."""

from __future__ import annotations

import multiprocessing
import queue
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import SpikingTacError
from spikingtac.events.source import EventSource, PacketSource
from spikingtac.live.factory import Factory
from spikingtac.markers.calibration.calibrate import CalibrationConfig, calibrate
from spikingtac.types import EventPacket

COLUMNS = ("x", "y", "p", "t")
RESULT_NAME = "result.json"
END_S = 2.0
"""Longest wait for a run that is given up, s."""


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
        context = multiprocessing.get_context("spawn")
        self._scratch, self._answers = scratch, context.Queue(1)
        arguments = (open_source, config, scratch.name, self._answers)
        self._process = context.Process(target=_calibrate, args=arguments, daemon=True)
        self._process.start()

    def poll(self) -> Calibration | str | None:
        """Return the calibration, or why there is none; None while it is computed."""
        try:
            answer = self._answers.get_nowait()
        except queue.Empty:
            if self._process.is_alive():
                return None
            answer = "the calibration's process ended; the machine may have run out of memory"
        if answer:
            return str(answer)
        return Calibration.load(Path(self._scratch.name) / RESULT_NAME)

    def close(self) -> None:
        """End the run, and remove what it wrote."""
        self._process.terminate()
        self._process.join(END_S)
        self._answers.cancel_join_thread()
        self._answers.close()
        self._scratch.cleanup()


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
    open_source: Factory[EventSource], config: CalibrationConfig, folder: str, answers: Any
) -> None:
    try:
        calibration = calibrate(open_source(), config)
        calibration.save(Path(folder) / RESULT_NAME)
        answers.put("")
    except (SpikingTacError, OSError) as error:
        answers.put(str(error))
    except Exception as error:  # told by the page like any other
        answers.put(f"{type(error).__name__}: {error}")


def named(calibration: Calibration, recording: str) -> Calibration:
    """Return a calibration with the name of the recording that it was learned from."""
    return replace(calibration, provenance={**calibration.provenance, "recording": recording})
