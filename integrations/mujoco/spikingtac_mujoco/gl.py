"""Which OpenGL draws the pictures: chosen before MuJoCo is imported, since it decides then."""

from __future__ import annotations

import ctypes.util
import os
import sys

OFF = "disabled"

# What MuJoCo draws with where there is no display -> its library, in the order of trial.
BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}


def choose() -> str:
    """Set ``MUJOCO_GL`` where there is no display, or where its library is missing; return it."""
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    found = [name for name, library in BACKENDS.items() if ctypes.util.find_library(library)]
    hidden = sys.platform == "linux" and not wanted and not shown
    if hidden or (wanted in BACKENDS and wanted not in found):
        os.environ["MUJOCO_GL"] = next(iter(found), OFF)
    return os.environ.get("MUJOCO_GL", "")


def missing() -> str:
    """Say what is missing for pictures."""
    absent = [f"lib{lib}.so" for lib in BACKENDS.values() if not ctypes.util.find_library(lib)]
    return (
        f"pictures need OpenGL; MUJOCO_GL is {os.environ.get('MUJOCO_GL', '')!r}, "
        f"and this machine lacks {' and '.join(absent) or 'a working driver'}; install libegl1 or "
        "libosmesa6; everything but pictures works without"
    )
