"""Names that the command line offers are names that the registry builds."""

from dataclasses import fields
from typing import get_args

import pytest

from spikingtac.errors import ConfigError
from spikingtac.markers.registry import make_law
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.types import LawName


@pytest.mark.parametrize("name", get_args(LawName))
def test_every_named_law_is_built(name: str) -> None:
    law = make_law(TrackingConfig(hysteresis=name))
    assert type(law) is not type(make_law(TrackingConfig(hysteresis=_another(name))))


def test_the_configuration_offers_the_same_laws() -> None:
    choices = {field.name: field.metadata.get("choices") for field in fields(TrackingConfig)}
    assert choices["hysteresis"] == get_args(LawName)


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(ConfigError, match="anchored"):
        make_law(TrackingConfig(hysteresis="anchor"))


def _another(name: str) -> str:
    names = get_args(LawName)
    return names[(names.index(name) + 1) % len(names)]
