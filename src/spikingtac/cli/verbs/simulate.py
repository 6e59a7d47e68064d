"""Render a scene of the digital twin into a recording folder with ground truth."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from spikingtac import sim
from spikingtac.cli.messages import progress, tell
from spikingtac.cli.options import WriteArgs
from spikingtac.errors import ConfigError
from spikingtac.events.recording import MANIFEST
from spikingtac.plugins import SCENE_DESIGNS, with_plugins
from spikingtac.sim.camera.config import CAMERA_NAMES


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Render a scene of the digital twin into a recording folder with ground truth.

    The scene is one of --list, or a TOML file of your own.

    Attributes:
        scene: Name of a scene, or the path of a TOML file.
        output: Folder to write: events.raw, truth.npz, manifest.json.
        seed: Seed of the motions' variations and of the camera's noise; equal seeds give equal
            bytes.
        duration_s: Length, s; a shorter one cuts the scene, a longer one repeats its contacts.
        camera: Camera preset; the scene's own (typical) unless given.
        serial: Serial number of the sensor, which sets its tolerances; the scene's own unless
            given.
        design: Put the scene on the sensor of a design: a name (see design --list), or a TOML file.
        list: Print the scenes, one per line: name, two spaces, description.
    """

    scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")] = ""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = None
    seed: int = 0
    duration_s: float | None = None
    camera: Annotated[str | None, tyro.conf.arg(metavar="|".join(CAMERA_NAMES))] = None
    serial: int | None = None
    design: Annotated[str | None, tyro.conf.arg(metavar="DESIGN")] = None
    list: bool = False


def run(args: Args) -> int:
    """Write the recording, or list the scenes."""
    if args.list:
        scenes = sim.scene_descriptions()
        if args.json:
            return tell(True, {"scenes": scenes})
        sys.stdout.writelines(f"{name}  {about}\n" for name, about in scenes.items())
        return 0
    if not args.scene or args.output is None:
        raise ConfigError(
            "give a scene and a folder: spikingtac simulate SCENE -o FOLDER "
            f"(scenes: {', '.join(sim.scene_names())}, or a TOML file)"
        )

    if (args.output / MANIFEST).is_file() and not args.overwrite:
        raise ConfigError(
            f"the folder {str(args.output)!r} holds a recording already; "
            "choose another one, or give --overwrite to replace it"
        )
    scene = sim.load_scene(args.scene).with_camera(args.camera).with_serial(args.serial)
    if args.design is not None:
        # The package that registers the designs puts the scene on one of them.
        scene = with_plugins({}, SCENE_DESIGNS)["design"](scene, args.design)
    with progress(f"simulating {args.scene}") as advance:
        given = {"seed": args.seed, "duration_s": args.duration_s, "overwrite": args.overwrite}
        summary = sim.simulate(scene, args.output, advance=advance, **given)
    seconds, events, markers = (summary[name] for name in ("duration_s", "events", "markers"))
    written = f"written: {args.output}, {seconds:.3f} s, {events:,} events, {markers} markers"
    return tell(args.json, {"scene": args.scene, **summary}, written)
