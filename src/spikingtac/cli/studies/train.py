"""``spikingtac train``: teach a denoiser on recordings, without labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.cli.messages import emit_json, progress, remark
from spikingtac.errors import MissingExtraError


@dataclass(frozen=True, kw_only=True)
class Args:
    """Train the denoising network on recordings, or on scenes of the digital twin.

    No labels are needed: a recording's truth.npz is never opened. The same command goes on with a
    run that was interrupted.
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Recording folders or event files of one sensor; none trains on the configuration's scenes."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = Path("training")
    """Folder of the run: log.jsonl, weights.safetensors, lean.onnx, lean-int8.onnx."""
    config: str = "lean"
    """lean (the shipped network) or evflownet (as the paper names it), or a TOML file."""
    bootstrap: Path | None = None
    """Recording of slides that shows every marker: its last map is where the others begin."""
    seed: int | None = None
    """Of weights, degradations and crops; the configuration's unless given."""
    rounds: int | None = None
    """Times that each recording is degraded anew; the configuration's unless given."""
    device: str | None = None
    """cpu or cuda; the configuration's unless given."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Train, export, and say where the weights are."""
    session = _torch_session()
    given = {"seed": args.seed, "rounds": args.rounds, "device": args.device}
    with progress("preparing recordings") as advance:
        prepared = session.prepare(
            args.config, args.output, args.recordings, args.bootstrap, given, advance
        )
    with progress("training") as advance:
        summary: dict[str, Any] = session.train_and_export(prepared, args.output, advance)
    if args.json:
        emit_json(summary)
    else:
        remark(f"loss {summary['loss']:.4f} after {summary['rounds']} rounds: {summary['int8']}")
    return 0


def _torch_session() -> Any:
    try:
        from spikingtac.experiments.denoise import training_session
    except ImportError as error:
        if error.name not in ("torch", "safetensors"):
            raise
        raise MissingExtraError(
            f"training needs {error.name}; install it with: pip install 'spikingtac[train]'"
        ) from error
    return training_session
