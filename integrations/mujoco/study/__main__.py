"""Make the tables of results/mujoco, or learn: ``python integrations/mujoco/study --help``."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

from evaluation import evaluate, speed, validate
from learn import train
from spikingtac_mujoco import TASKS

LEARNED = "grip_ppo.npz"
ABOUT = {
    "validation": "## `markers` against `events`\n\nThe same motions seen by both. Errors in px "
    "are against the true displacement, those in N are of one force model "
    "(`spikingtac.fit_force`), fitted on other episodes of `markers` only. `events` solves the gel "
    "on 64 x 64 cells, `markers` on 32 x 32.",
    "speed": "## Speed\n\nSteps in a second of one core (CPU time), the scripted policy, "
    "no pictures.",
    "policies": "## What touch is worth\n\nMeans over the seeds from 0 on, with 95 % intervals "
    "(Wilson for shares, bootstrap for means). Excess is the grip force at the end over the least "
    "that holds; aside is the distance between the axes of peg and bore.",
}
UNIT = re.compile(r"_(mm|s|n)$")


def _unit(found: re.Match[str]) -> str:
    return f", {found[1].upper() if found[1] == 'n' else found[1]}"


def table(rows: list[dict[str, Any]]) -> str:
    """Return rows as a table in Markdown, with the columns of the first."""
    head = [UNIT.sub(_unit, name).replace("_", " ") for name in rows[0]]
    lines = [head, ["---"] * len(head)]
    lines += [[str(row.get(name, "")) for name in rows[0]] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def make(part: str, folder: Path, seeds: int, workers: int) -> dict[str, Any]:
    """Return the figures of a part."""
    if part == "validation":
        return validate()
    if part == "speed":
        rows = [speed(task, "markers") for task in TASKS]
        return {"rows": [*rows, speed("GripWithoutSlip", "events")]}
    learned = folder / LEARNED if (folder / LEARNED).is_file() else None
    return {task: evaluate(task, seeds, learned, workers) for task in TASKS}


def page(known: dict[str, Any]) -> str:
    """Return the page for people."""
    command = "`python integrations/mujoco/study table`"
    parts = [f"# The sensor in MuJoCo: figures\n\nAll simulated; made by {command}."]
    for part, found in known.items():
        parts.append(ABOUT[part].format(**found))
        if "rows" in found:
            parts.append(table(found["rows"]))
        else:
            parts += [f"### {task}\n\n{table(rows)}" for task, rows in found.items()]
        if "tracker" in found:
            told = ", ".join(f"{name} {value:.4g}" for name, value in found["tracker"].items())
            parts.append(f"The tracker behind the events: {told}.")
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Run a verb."""
    top = argparse.ArgumentParser(prog="study", description=__doc__)
    top.add_argument("verb", choices=["table", "train"])
    top.add_argument("-o", "--output", type=Path, default=Path("results/mujoco"))
    top.add_argument("--only", choices=list(ABOUT), nargs="*", default=list(ABOUT))
    top.add_argument("--seeds", type=int, default=100)
    top.add_argument("--workers", type=int, default=2)
    top.add_argument("--minutes", type=float, default=18.0, help="of learning")
    given = top.parse_args()
    folder = given.output
    folder.mkdir(parents=True, exist_ok=True)
    if given.verb == "train":
        found = train(folder / LEARNED, given.minutes)
        (folder / "training.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        return
    for part in given.only:
        found = make(part, folder, given.seeds, given.workers)
        (folder / f"{part}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    files = {part: folder / f"{part}.json" for part in ABOUT}
    known = {part: json.loads(path.read_text()) for part, path in files.items() if path.is_file()}
    (folder / "README.md").write_text(page(known), encoding="utf-8")


if __name__ == "__main__":
    main()
