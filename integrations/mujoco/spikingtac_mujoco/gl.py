"""Which OpenGL draws the pictures: chosen before MuJoCo is imported, since it decides then."""

from __future__ import annotations

import ctypes.util
import os
import sys

OFF = "disabled"
BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}
"""What MuJoCo draws with where there is no display -> its library."""


def choose() -> str:
    """Set ``MUJOCO_GL`` where it is not set and there is no display, and return it."""
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and "MUJOCO_GL" not in os.environ and not shown:
        found = (name for name, library in BACKENDS.items() if ctypes.util.find_library(library))
        os.environ["MUJOCO_GL"] = next(found, OFF)
    return os.environ.get("MUJOCO_GL", "")


def missing() -> str:
    """Say what is missing for pictures."""
    lacks = [
        f"lib{library}.so" for library in BACKENDS.values() if not ctypes.util.find_library(library)
    ]
    return (
        f"pictures need OpenGL without a display, MUJOCO_GL is {os.environ.get('MUJOCO_GL', '')!r} "
        f"and this machine lacks {' and '.join(lacks) or 'a working driver'}; install libegl1 or "
        "libosmesa6 and set MUJOCO_GL=egl or osmesa; everything but pictures works without"
    )
