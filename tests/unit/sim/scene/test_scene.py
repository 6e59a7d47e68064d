import dataclasses
import tempfile
from pathlib import Path

import pytest

from spikingtac.errors import SettingsFileError
from spikingtac.sim.catalog import load_scene
from spikingtac.sim.scene import Scene, SkinConfig

CONTACT = """
[[contacts]]
indenter = { kind = "ball" }
[contacts.motion]
height_mm = 0.3
segments = [
  { kind = "press", depth_mm = 0.5, duration_s = 0.1 },
  { kind = "lift", duration_s = 0.1 },
]
"""


def scene(text: str) -> Scene:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return load_scene(path)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lead_in = 1.0", r"unknown key 'lead_in'; did you mean 'lead_in_s'\?"),
        ("[skin]\npitch = 2.0", r"scene\.toml\.skin: unknown key 'pitch'; did you mean 'pitch_mm'"),
        ("[camera.settings.light]\ncontrst = 3.0", "did you mean 'contrast'"),
        ("[history]\nreferences = 'new'", "valid: rested, random, fresh"),
        ("[optics.discs]\nmissing = [64]", "marker 64 does not exist, valid are 0 to 63"),
        ("[skin]\ngrid = [100000, 100000]", "valid are 1 to 10000 markers"),
        ("[gel.grid]\ncells = 1000000000", "cells is 1e[+]09, valid are 8 to 512"),
        ("[optics]\nsize = [100000, 100000]\nk1 = 0.0", "valid are 1 to 2097152 pixels in all"),
        (
            CONTACT.replace("[[contacts]]", "[[contacts]]\nrepeats = 1000000000"),
            "valid are 1 to 10000",
        ),
        ("duration_s = 1e15", "duration_s is 1e[+]15, valid are 0.001 to 100000"),
        ("lead_in_s = 1" + "0" * 5000, "not valid TOML"),
        ("about = " + "[" * 100_000 + "]" * 100_000, "nested deeper than 32"),
        (".".join("a" * 100_000) + " = 1", "nested deeper than 32"),
        ("about = '" + "x" * (1 << 20) + "'", "longer than 1048576 bytes"),
        (CONTACT.replace("ball", "bal"), r"unknown indenter 'bal'; did you mean 'ball'\?"),
        (CONTACT.replace('"lift"', '"hold"'), "end above it"),
        (CONTACT.replace("height_mm = 0.3", "height_mm = -0.1"), "must start above the skin"),
    ],
)
def test_a_wrong_file_names_the_key_and_what_is_valid(text: str, expected: str):
    with pytest.raises(SettingsFileError, match=expected):
        scene(text)


def test_the_digest_follows_every_value_that_counts():
    first = scene(CONTACT)
    assert first.digest() == scene(CONTACT).digest()
    assert len(first.digest()) == 64
    others = (
        first.with_camera("noisy"),
        dataclasses.replace(first, skin=SkinConfig(serial=2)),
        scene(CONTACT.replace("0.5", "0.6")),
    )
    assert len({first.digest(), *(other.digest() for other in others)}) == 4
