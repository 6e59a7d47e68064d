"""The denoisers by name."""

from __future__ import annotations

from collections.abc import Callable

from spikingtac.denoise.classical import CLASSICAL_DENOISERS
from spikingtac.denoise.denoiser import Denoiser
from spikingtac.errors import named


def _network(name: str) -> Callable[[], Denoiser]:
    def build() -> Denoiser:
        from spikingtac.denoise.infer import shipped_denoiser  # with ONNX Runtime behind it

        return shipped_denoiser(name)

    return build


# ``tracking.denoiser`` -> builder.
DENOISERS: dict[str, Callable[[], Denoiser]] = {
    **CLASSICAL_DENOISERS,
    **{name: _network(name) for name in ("network", "network-int8")},
}


def make_denoiser(name: str) -> Denoiser:
    """Build the denoiser of a name."""
    return named(DENOISERS, name, "denoiser")()
