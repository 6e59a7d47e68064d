"""Train the denoising network on recordings, without labels."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.cli import WriteArgs, progress, tell
from spikingtac.errors import import_extra

RECORDINGS = "recordings"  # Folder of a run that holds the rendered scenes.


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Train the denoising network on recordings, or on scenes of the digital twin.

    Training needs no labels: it never opens a recording's truth.npz. The same command continues a
    run that was interrupted.

    Attributes:
        recordings: Recording folders or event files of one sensor; scenes of the twin
            unless given.
        output: Folder of the run: log.jsonl, weights.safetensors, lean.onnx, lean-int8.onnx.
        config: lean (the shipped network) or evflownet (as the paper names it), or a TOML file.
        bootstrap: Recording of slides that shows every marker: its last map is the first map of the
            others.
        seed: Seed of weights, degradations and crops; the configuration's unless given.
        rounds: Number of times each recording is degraded anew; the configuration's unless given.
        device: cpu or cuda; the configuration's unless given.
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = Path("training")
    config: str = "lean"
    bootstrap: Path | None = None
    seed: int | None = None
    rounds: int | None = None
    device: str | None = None


def run(args: Args) -> int:
    """Train, export, and print where the weights are."""
    session = _torch_session()
    config = session.load_training_config(
        args.config, seed=args.seed, rounds=args.rounds, device=args.device
    )
    if args.overwrite:
        session.forget_run(args.output)
    with progress("preparing recordings") as advance:
        if args.recordings:
            recordings = session.from_recordings(args.recordings, args.bootstrap)
        else:
            recordings = session.from_scenes(_recorder(args.output), advance)
    with progress("training") as advance:
        summary: dict[str, Any] = session.train_and_export(config, recordings, args.output, advance)
    told = f"loss {summary['loss']:.4f} after {summary['rounds']} rounds: {summary['int8']}"
    return tell(args.json, summary, told)


def _recorder(folder: Path) -> Any:
    """Return a function that renders a scene into the run's folder, if it is not there yet."""
    from spikingtac.events import MANIFEST
    from spikingtac.sim import load_scene, simulate

    def record(name: str, seed: int) -> Path:
        target = folder / RECORDINGS / f"{name}-{seed}"
        if not (target / MANIFEST).is_file():
            simulate(load_scene(name), target, seed=seed, overwrite=True)
        return target

    return record


def _torch_session() -> Any:
    for library in ("torch", "safetensors", "onnx"):
        import_extra(library, "training", "train")
    from spikingtac_paper.training import train as session

    return session
