"""Every setting that the page shows has a plain name and an explanation, and no other has."""

from __future__ import annotations

import dataclasses
import re
from importlib import resources
from typing import get_args

from spikingtac.config import load_config
from spikingtac.tuning import in_use
from spikingtac.types import LawName


def shown() -> set[str]:
    names: set[str] = set()
    for preset in ("default", "fast", "paper"):
        config = load_config(preset).tracking
        for law in get_args(LawName):
            changed = dataclasses.replace(config, hysteresis=law)
            names |= {control.name for control in in_use(changed)}
    return names


def test_every_setting_has_plain_words() -> None:
    text = (resources.files("spikingtac.viewer.web") / "page" / "words.js").read_text("utf-8")
    entries = re.findall(r'"(.+?)": \["(.+?)", "(.+?)"\]', text)
    words = {name: (plain, about) for name, plain, about in entries}
    assert set(words) == shown()
    for plain, about in words.values():
        assert "_" not in plain
        assert about.endswith(".")
