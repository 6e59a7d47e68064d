"""The encoder-decoder that turns a noisy state map into a clean one (paper section IV-B).

Two sizes. ``lean`` (ours) works on the map folded into blocks of 8x8 pixels, each block a pixel of
64 channels: a few hundredths of the arithmetic, so that one core cleans far more than 350 maps a
second. ``evflownet`` follows the architecture that the paper names: four strided encoders of 64 to
512 channels, two residual blocks, four decoders with skip connections (A. Zhu et al., "EV-FlowNet",
RSS 2018, doi:10.15607/RSS.2018.XIV.062); it needs 20 GMAC for a map of 320x320.

The folding stands outside of the network (:mod:`spikingtac.denoise.network.fold`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

EVFLOWNET_LEVELS = 4
"""Encoders and decoders of EV-FlowNet."""
RESIDUAL_BLOCKS = 2
"""Residual blocks between them, as in EV-FlowNet."""
SMOOTHING = (1.0, 4.0, 6.0, 4.0, 1.0)
"""Binomial weights of the smoothed map, along each axis."""
SMOOTH_GAIN = 6.0
"""First weight of the smoothed map in the logit: an untrained network is that blur, sharpened."""
HALF = 0.5
"""Level between ground and marker: the smoothed map counts as evidence above and below it."""
LEAN_LEVELS = 2
"""Resolutions of the lean network: blocks, and pairs of blocks."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkConfig:
    """Size of the network.

    Attributes:
        kind: ``lean`` (ours) or ``evflownet`` (as the paper names it).
        fold: Pixels along each side of a block; 1 folds nothing.
        widths: For ``lean``: channels at the two resolutions.
        kernels: For ``lean``: sides of the first and of the last convolution, blocks. With 1 both
            look at their own block alone, as those between them look around.
        depth: For ``lean``: convolutions at the coarse resolution, after the one that leads there.
        base: For ``evflownet``: channels of the first encoder (64 as published).
    """

    kind: Literal["lean", "evflownet"] = "lean"
    fold: int = 8
    widths: tuple[int, int] = (32, 32)
    kernels: tuple[int, int] = (3, 3)
    depth: int = 1
    base: int = 64

    def __post_init__(self) -> None:
        if self.fold not in (1, 2, 4, 8):
            raise ValueError(f"fold is {self.fold}, valid are 1, 2, 4 and 8")
        if min(*self.widths, self.depth, self.base) < 1:
            raise ValueError("widths, depth and base must be positive")
        if not set(self.kernels) <= {1, 3}:
            raise ValueError(f"kernels are {list(self.kernels)}, valid are 1 and 3")

    @property
    def multiple_px(self) -> int:
        """A map's sides are padded to a multiple of this, px."""
        levels = LEAN_LEVELS - 1 if self.kind == "lean" else EVFLOWNET_LEVELS
        return self.fold * 2**levels


def _block(inputs: int, outputs: int, stride: int = 1, kernel: int = 3) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2), nn.ReLU())


class LeanUNet(nn.Module):
    """Two resolutions, a few convolutions, and a smoothed map that is weighed block by block.

    Fewer channels than a block has pixels carry the outline of a marker, but not single pixels. A
    direct path for the map itself made the network subtract each noisy pixel, and it learned next
    to nothing; without any, rims came out too smooth. The smoothed map has the rims and little of
    the noise: the convolutions say where a marker can be, and how far to trust what is seen.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        pixels = config.fold**2
        fine, coarse = config.widths
        first, last = config.kernels
        self.stem = _block(pixels, fine, kernel=first)
        self.down = _block(fine, coarse, stride=2)
        self.middle = nn.Sequential(*(_block(coarse, coarse) for _ in range(config.depth)))
        self.up = _block(fine + coarse, fine)
        self.head = nn.Conv2d(fine, pixels, last, 1, last // 2)
        self.trust = nn.Conv2d(fine, 1, 1)
        for layer, bias in ((self.head, 0.0), (self.trust, SMOOTH_GAIN)):
            nn.init.zeros_(layer.weight)
            nn.init.constant_(layer.bias, bias)  # type: ignore[arg-type]

    def forward(self, folded: Tensor, evidence: Tensor) -> Tensor:
        """Return logits of the same shape.

        Args:
            folded: ``(n, fold^2, height / fold, width / fold)`` from 0 to 1.
            evidence: The smoothed map less one half, folded alike.
        """
        fine = self.stem(folded)
        coarse = self.middle(self.down(fine))
        wide = functional.interpolate(coarse, scale_factor=2.0, mode="nearest")
        joined = self.up(torch.cat([fine, wide], 1))
        return self.head(joined) + functional.relu(self.trust(joined)) * evidence


class _Residual(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _block(channels, channels)
        self.second = nn.Conv2d(channels, channels, 3, 1, 1)

    def forward(self, values: Tensor) -> Tensor:
        return functional.relu(values + self.second(self.first(values)))


class EvFlowNet(nn.Module):
    """EV-FlowNet's encoder-decoder with one output channel per pixel of a block."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        pixels = config.fold**2
        widths = [config.base * 2**level for level in range(EVFLOWNET_LEVELS)]
        self.encoders = nn.ModuleList(
            _block(inputs, outputs, stride=2)
            for inputs, outputs in zip([pixels, *widths[:-1]], widths, strict=True)
        )
        self.residuals = nn.Sequential(*(_Residual(widths[-1]) for _ in range(RESIDUAL_BLOCKS)))
        after = [*reversed(widths[:-1]), config.base // 2]
        self.decoders = nn.ModuleList(
            _block(2 * inputs, outputs)
            for inputs, outputs in zip(reversed(widths), after, strict=True)
        )
        self.head = nn.Conv2d(after[-1], pixels, 1)

    def forward(self, folded: Tensor, evidence: Tensor) -> Tensor:
        """Return logits; see :meth:`LeanUNet.forward`. The evidence is not used."""
        skips = []
        values = folded
        for encoder in self.encoders:
            values = encoder(values)
            skips.append(values)
        values = self.residuals(values)
        for decoder, skip in zip(self.decoders, reversed(skips), strict=True):
            joined = torch.cat([values, skip], 1)
            values = decoder(functional.interpolate(joined, scale_factor=2.0, mode="nearest"))
        return self.head(values)


def make_network(config: NetworkConfig) -> nn.Module:
    """Build an untrained network; its weights come from torch's generator."""
    return LeanUNet(config) if config.kind == "lean" else EvFlowNet(config)


def apply_network(network: nn.Module, maps: Tensor, fold: int) -> Tensor:
    """Smooth, fold, run the network and unfold.

    Args:
        network: From :func:`make_network`.
        maps: ``(n, 1, height, width)`` from 0 to 1.
        fold: Pixels along each side of a block.

    Returns:
        Logits of the same shape.
    """
    line = torch.tensor(SMOOTHING, device=maps.device) / sum(SMOOTHING)
    reach = len(SMOOTHING) // 2
    padded = functional.pad(maps, (reach,) * 4, mode="replicate")
    evidence = functional.conv2d(padded, torch.outer(line, line)[None, None]) - HALF
    folded = (functional.pixel_unshuffle(values, fold) for values in (maps, evidence))
    return functional.pixel_shuffle(network(*folded), fold)


def multiply_adds(network: nn.Module, config: NetworkConfig, size: tuple[int, int]) -> int:
    """Count the multiplications of the convolutions for one map of ``(width, height)`` px."""
    counted = 0

    def count(module: nn.Module, _: tuple[Tensor, ...], output: Tensor) -> None:
        nonlocal counted
        assert isinstance(module, nn.Conv2d)
        counted += output[0].numel() * module.weight[0].numel()

    hooks = [
        module.register_forward_hook(count)
        for module in network.modules()
        if isinstance(module, nn.Conv2d)
    ]
    with torch.no_grad():
        apply_network(network, torch.zeros(1, 1, size[1], size[0]), config.fold)
    for hook in hooks:
        hook.remove()
    return counted
