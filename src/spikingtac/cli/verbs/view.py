"""``spikingtac view``, ``demo`` and ``simulate``: a recording or a scene, shown or rendered."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from spikingtac.cli.messages import UNTRACKED, figures, progress, remark, tell
from spikingtac.cli.options import RealtimeArgs, TrackerArgs, WriteArgs
from spikingtac.cli.sources import ask_for_real_time, require_live
from spikingtac.errors import ConfigError
from spikingtac.plots.figure import PICTURE_ENDINGS
from spikingtac.sim.camera.config import CAMERA_NAMES
from spikingtac.viewer.access import PageOptions

if TYPE_CHECKING:
    from spikingtac.viewer.source import ViewSource

Opener = Callable[[], "ViewSource"]  # Opens a view, in the process that shows it.
SCENE = "demo"  # Scene of the demo.
HEADLESS_S = 10.0  # Duration of a live source with --headless where --seconds is not given, s.


@dataclass(frozen=True, kw_only=True)
class PageArgs(WriteArgs, PageOptions):
    """Options of verbs that show a source on the page.

    Attributes:
        preset: default, fast or paper, or a TOML file.
        headless: Without a page: track a recording to its end, a camera or a scene for --seconds.
        picture: Summary picture to write of what the page showed (.png, .svg, .pdf), or as
            --export.
    """

    preset: str = "default"
    headless: bool = False
    picture: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None


@dataclass(frozen=True, kw_only=True)
class Args(PageArgs, RealtimeArgs, TrackerArgs):
    """Show a recording, a recording folder or a scene of the twin in the browser.

    Without --calibration, the page shows the events of a sensor, and calibrates.

    Attributes:
        source: Event file, recording folder, a camera (its address, a named pipe, or -), or name of
            a scene (spikingtac simulate --list).
        calibrate: Calibrate with the page, even where a calibration is known.
        save_calibration: File that a calibration made with the page is saved as.
        force: force.onnx: show force, patch, slip and vibration; make one with: spikingtac force
            fit.
        seed: Seed of a scene.
        camera: Camera preset of a scene; the scene's own unless given.
        export: File to track into instead: .mcap (ROS 2), .mp4, .gif, .png, .svg or .pdf.
    """

    source: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SOURCE")]
    calibrate: bool = False
    save_calibration: Path = Path("calibration.json")
    force: Path | None = None
    seed: int = 0
    camera: Annotated[str | None, tyro.conf.arg(metavar="|".join(CAMERA_NAMES))] = None
    export: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None


def run(args: Args) -> int:
    """Serve the page, and print the summary at its end."""
    from spikingtac.viewer.calibrating import SaveTarget
    from spikingtac.viewer.opening import open_view

    _check_together(args)
    same = ("source", "preset", "rate_hz", "seed", "camera")
    given: dict[str, Any] = {name: getattr(args, name) for name in same}
    given |= {
        name: path and str(path)
        for name, path in (("calibration", args.calibration), ("force", args.force))
    }
    target = args.export or args.picture
    save = SaveTarget(path=args.save_calibration, overwrite=args.overwrite, anew=args.calibrate)
    if target is not None and (args.export or target.suffix.lower() not in PICTURE_ENDINGS):
        # Events alone make a picture; what else is exported holds markers.
        alone = {"save": save} if target.suffix.lower() in PICTURE_ENDINGS else {}
        summary = _exported(partial(open_view, **given, **alone), args, target)
    else:
        summary = _shown(partial(open_view, **given, save=save), args, realtime=args.realtime)
    return _report(args.source, summary, args.json)


def _check_together(args: Args) -> None:
    """Refuse options that do not go together."""
    from spikingtac.viewer.opening import is_scene

    args.refuse("is for scenes", "seed", "camera", where=not is_scene(args.source))
    of_page = "realtime", "calibrate", "picture"
    args.refuse("is for the page, not for --export", *of_page, where=args.export is not None)
    args.refuse("is not for --calibrate", "calibration", "force", where=args.calibrate)
    require_live([args.source], where=args.realtime)


def _exported(opener: Opener, args: Args, target: Path) -> dict[str, Any]:
    from spikingtac.viewer.export import ENDINGS, export

    args.refuse("is for the page; an export shows no forces", "force")
    args.claim(target, endings=ENDINGS)
    with progress(f"exporting to {target.name}"):
        view = opener()
        written = export(view, target, seconds=args.seconds)
    return {"export": str(target), "written": written, "calibration": view.calibrated_by or None}


def _shown(opener: Opener, args: PageArgs, **session: bool) -> dict[str, Any]:
    """Serve a view; with --headless track a recording to its end, what is live for some time."""
    from spikingtac.viewer.export import summarize
    from spikingtac.viewer.show import show

    args.claim(args.picture, endings=PICTURE_ENDINGS)
    if not args.headless:
        found = show(opener, args, remark, picture=args.picture, **session)
    else:
        if session.get("realtime"):
            ask_for_real_time()
        view = opener()
        seconds = args.seconds if view.ends else args.seconds or HEADLESS_S
        with progress(f"tracking {view.label}"):
            found = summarize(view, seconds=seconds, picture=args.picture)
    return found if args.picture is None else {**found, "picture": str(args.picture)}


def _report(source: str, summary: dict[str, Any], as_json: bool) -> int:
    shown = summary | {"calibration": summary.get("calibration") or "none"}
    if "written" in summary:
        unit = "messages" if summary["export"].lower().endswith(".mcap") else "frames"
        shown["written"] = f"{summary['written']} {unit}"
    untracked = [] if summary.get("written", 1) else [UNTRACKED]
    table = figures(f"summary of {source}", shown)
    return tell(as_json, {"source": source, **summary}, table, *untracked)


@dataclass(frozen=True, kw_only=True)
class DemoArgs(PageArgs):
    """A finger presses, twists and slides on the simulated skin; watch it in the browser.

    Gel, optics and event camera are simulated as you watch; the tracker sees only the events.

    Attributes:
        seed: Seed of place, depth and speed of the finger.
    """

    seed: int = 1


def demo(args: DemoArgs) -> int:
    """Simulate, track and serve, and print the summary at the end."""
    from spikingtac.viewer.opening import open_view

    remark("simulating a finger on the skin; the first start compiles its kernels")
    opener = partial(open_view, SCENE, preset=args.preset, seed=args.seed)
    return _report(SCENE, _shown(opener, args, repeat=True), args.json)


@dataclass(frozen=True, kw_only=True)
class SimulateArgs(WriteArgs):
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


def simulate(args: SimulateArgs) -> int:
    """Write the recording, or list the scenes."""
    from spikingtac import sim
    from spikingtac.plugins import SCENE_DESIGNS, WithPlugins

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
    scene = sim.load_scene(args.scene).with_camera(args.camera).with_serial(args.serial)
    if args.design is not None:
        # The package that registers the designs puts the scene on one of them.
        scene = WithPlugins({}, SCENE_DESIGNS)["design"](scene, args.design)
    with progress(f"simulating {args.scene}") as advance:
        given = {"seed": args.seed, "duration_s": args.duration_s, "overwrite": args.overwrite}
        summary = sim.simulate(scene, args.output, advance=advance, **given)
    seconds, events, markers = (summary[name] for name in ("duration_s", "events", "markers"))
    written = f"written: {args.output}, {seconds:.3f} s, {events:,} events, {markers} markers"
    return tell(args.json, {"scene": args.scene, **summary}, written)
