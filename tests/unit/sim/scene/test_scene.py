import dataclasses
import tomllib

import numpy as np
import pytest

from spikingtac.errors import ConfigError
from spikingtac.schema import build
from spikingtac.sim.scene.scene import Scene, SkinConfig, read_scene

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
    return build(Scene, tomllib.loads(text), "scene")


def test_an_empty_file_is_a_quiet_scene_of_the_papers_sensor():
    empty = scene("")
    assert empty.size == (320, 320)
    assert empty.skin.grid == (8, 8)
    assert empty.contacts == ()
    assert empty.camera.preset == "typical"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("lead_in = 1.0", r"unknown key 'lead_in'; did you mean 'lead_in_s'\?"),
        ("[skin]\npitch = 2.0", r"scene\.skin: unknown key 'pitch'; did you mean 'pitch_mm'"),
        ("[skin]\ngrid = [0, 8]", "both numbers must be positive"),
        ("[camera]\npreset = 'tipical'", "did you mean 'typical'"),
        ("[camera.settings.light]\ncontrst = 3.0", "did you mean 'contrast'"),
        ("[camera.settings.pixel]\nthreshold_on = 0.001", "at least 0.02"),
        ("[history]\nreferences = 'new'", "valid: rested, random, fresh"),
        ("[variation]\ndepth_fraction = 2.0", "depth_fraction is 2.0, valid are 0 to 0.9"),
        ("[optics.discs]\nmissing = [64]", "marker 64 does not exist, valid are 0 to 63"),
        ("mechanics_hz = 1.0", "valid are 50 to 2000"),
        (CONTACT.replace("ball", "bal"), r"unknown indenter 'bal'; did you mean 'ball'\?"),
        (CONTACT.replace("depth_mm", "depth"), "unknown key 'depth'; did you mean 'depth_mm'"),
        (CONTACT.replace('"lift"', '"hold"'), "end above it"),
        (CONTACT.replace("height_mm = 0.3", "height_mm = -0.1"), "must start above the skin"),
    ],
)
def test_a_wrong_file_names_the_key_and_what_is_valid(text: str, expected: str):
    with pytest.raises(ConfigError, match=expected):
        scene(text)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        read_scene(tmp_path / "none.toml")


def test_settings_lie_over_the_preset_and_survive_another_one():
    own = scene("[camera.settings.light]\ntexture = 0.2")
    typical, clean = (
        own.with_camera(name).camera.resolve(own.size) for name in ("typical", "clean")
    )
    assert typical.light.texture == clean.light.texture == 0.2
    assert typical.light.contrast == 6.0
    assert typical.background.rate_hz == 0.1
    assert clean.background.rate_hz == 0.0
    assert own.with_camera(None) is own


def test_the_camera_takes_the_size_of_the_optics():
    assert scene("[optics]\nsize = [640, 480]").camera.resolve((640, 480)).size == (640, 480)


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


def test_the_grid_is_row_major_about_the_axis():
    rest = SkinConfig(grid=(2, 3), pitch_mm=2.0).rest_mm()
    expected = [[-2, -1], [0, -1], [2, -1], [-2, 1], [0, 1], [2, 1]]
    np.testing.assert_allclose(rest, expected)
