"""Designs from TOML: every stored one loads, files may hold a few keys, mistakes are named."""

from __future__ import annotations

from pathlib import Path

import pytest

from spikingtac.errors import ConfigError
from spikingtac.schema import merged, to_mapping, to_toml
from spikingtac_hardware.parameters.design import DEFAULT, descriptions, load_design, names


def written(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_the_default_comes_first_and_every_design_says_what_it_is() -> None:
    assert names()[0] == DEFAULT
    assert {"markers-16x16", "round-fingertip", "gelsight-like"} <= set(names())
    assert list(descriptions()) == list(names())
    assert all(descriptions().values())


@pytest.mark.parametrize("name", names())
def test_a_design_survives_its_own_file(name: str, tmp_path: Path) -> None:
    design = load_design(name)
    assert load_design(written(tmp_path, to_toml(to_mapping(design)))) == design


def test_a_file_changes_only_what_it_names(tmp_path: Path) -> None:
    mine = load_design(written(tmp_path, f'based_on = "{DEFAULT}"\n[skin]\ngel_mm = 2.0\n'))
    base = load_design()
    assert mine.skin.gel_mm == 2.0
    assert (mine.skin.cover_mm, mine.lens) == (base.skin.cover_mm, base.lens)


def test_a_file_may_be_based_on_a_file(tmp_path: Path) -> None:
    first = written(tmp_path, f'based_on = "{DEFAULT}"\n[skin]\ngel_mm = 2.0\n', "first.toml")
    second = written(tmp_path, f'based_on = "{first}"\n[skin]\ncover_mm = 0.4\n', "second.toml")
    skin = load_design(second).skin
    assert (skin.gel_mm, skin.cover_mm) == (2.0, 0.4)


def test_a_circle_of_files_is_refused(tmp_path: Path) -> None:
    one, other = tmp_path / "one.toml", tmp_path / "other.toml"
    one.write_text(f'based_on = "{other}"\n')
    other.write_text(f'based_on = "{one}"\n')
    with pytest.raises(ConfigError, match="is based on itself"):
        load_design(one)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[skin]\ngell_mm = 2.0\n", "did you mean 'gel_mm'"),
        ("[skin]\ngel_mm = -1.0\n", "gel_mm is -1.0, it must be positive"),
        ("[skin]\ngel_index = 0.9\n", "gel_index is 0.9, it must be at least 1"),
        ("[window]\nindex = 0.9\n", "index is 0.9, it must be at least 1"),
        ("[lens]\nhalf_angle_deg = 90.0\n", "must be below 90"),
        ("[light]\nleds = 6\n", "multiple of 4"),
        ('[housing]\noutline = "round"\n', "give both the same outline"),
        ('[housing]\noutline = "oval"\n', "valid: rectangle, round"),
        ('[skin]\noutline = "round"\nsize_mm = [20.0, 10.0]\n', "one diameter twice"),
    ],
)
def test_a_mistake_is_named(text: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=reason):
        load_design(written(tmp_path, f'based_on = "{DEFAULT}"\n{text}'))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('based_on = "papersize"\n', "did you mean 'paper-size'"),
        ("based_on = 3\n", "expected the name of a design"),
        ('about = "nothing else"\n', "is missing"),
    ],
)
def test_a_wrong_base_is_named(text: str, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=reason):
        load_design(written(tmp_path, text))


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="did you mean 'round-fingertip'"):
        load_design("round-fingertop")


def test_a_barrel_may_be_negative_and_zero() -> None:
    lens = load_design().lens
    assert lens.distortion < 0
    assert lens.k1 == pytest.approx(lens.distortion / 1.428148**2, rel=1e-5)  # tan 55 degrees


def test_tables_are_merged_key_by_key() -> None:
    base = {"a": {"x": 1, "y": 2}, "b": 3}
    assert merged(base, {"a": {"y": 5}, "c": 4}) == {"a": {"x": 1, "y": 5}, "b": 3, "c": 4}
    assert base == {"a": {"x": 1, "y": 2}, "b": 3}
