"""The encoder-decoder network that denoises a state map (paper section IV-B).

There are two kinds. ``lean`` works on the map in blocks of 8x8 pixels, each block a pixel of
64 channels. It needs a few hundredths of the arithmetic, so that one core denoises far more than
350 maps per second. ``evflownet`` follows the architecture that the paper names: four strided
encoders of 64 to 512 channels, two residual blocks, four decoders with skip connections (A. Zhu et
al., "EV-FlowNet", RSS 2018, doi:10.15607/RSS.2018.XIV.062). It needs 20 GMAC for a map of 320x320.

The conversion to blocks is outside of the network (:mod:`spikingtac.denoise.blocks`).
"""

from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

EVFLOWNET_LEVELS = 4  # Number of encoders, and of decoders, of EV-FlowNet.
RESIDUAL_BLOCKS = 2  # Number of residual blocks between them, as in EV-FlowNet.
SMOOTHING = (1.0, 4.0, 6.0, 4.0, 1.0)  # Binomial weights of the smoothed map, along each axis.

# Initial weight of the smoothed map in the logit. An untrained network is a sharpened blur.
SMOOTH_GAIN = 6.0
HALF = 0.5  # Level between ground and marker; it is subtracted from the smoothed map.
LEAN_WIDTHS = (32, 32)  # Channels of the lean network, of blocks and of pairs of blocks.
LEAN_DEPTH = 2  # Number of convolutions at its coarse resolution, after the strided one.

NetworkKind = Literal["lean", "evflownet"]  # The latter is what the paper names.
FOLD: dict[NetworkKind, int] = {"lean": 8, "evflownet": 1}  # Side of a block, px.

# The sides of a map are padded to a multiple of this, px: a pair of blocks, or 2^4 pixels.
MULTIPLE_PX = 16


def _block(inputs: int, outputs: int, stride: int = 1, kernel: int = 3) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2), nn.ReLU())


class LeanUNet(nn.Module):
    """Two resolutions, a few convolutions, and a smoothed map with one weight per block.

    With fewer channels than pixels of a block, the channels represent the outline of a marker but
    not single pixels. With a direct path for the map itself the network subtracted each noisy pixel
    and learned next to nothing; without any, the edges were too smooth. The smoothed map has the
    edges and little of the noise. The convolutions give the places of markers and the weight of the
    smoothed map.
    """

    def __init__(self) -> None:
        super().__init__()
        pixels = FOLD["lean"] ** 2
        fine, coarse = LEAN_WIDTHS
        # The first and the last convolution see their own block only.
        self.stem = _block(pixels, fine, kernel=1)
        self.down = _block(fine, coarse, stride=2)
        self.middle = nn.Sequential(*(_block(coarse, coarse) for _ in range(LEAN_DEPTH)))
        self.up = _block(fine + coarse, fine)
        self.head = nn.Conv2d(fine, pixels, 1)
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
    """EV-FlowNet's encoder-decoder with one output channel per pixel of a block.

    Args:
        base: Channels of the first encoder (64 as published).
    """

    def __init__(self, base: int = 64) -> None:
        super().__init__()
        pixels = FOLD["evflownet"] ** 2
        widths = [base * 2**level for level in range(EVFLOWNET_LEVELS)]
        self.encoders = nn.ModuleList(
            _block(inputs, outputs, stride=2)
            for inputs, outputs in zip([pixels, *widths[:-1]], widths, strict=True)
        )
        self.residuals = nn.Sequential(*(_Residual(widths[-1]) for _ in range(RESIDUAL_BLOCKS)))
        after = [*reversed(widths[:-1]), base // 2]
        self.decoders = nn.ModuleList(
            _block(2 * inputs, outputs)
            for inputs, outputs in zip(reversed(widths), after, strict=True)
        )
        self.head = nn.Conv2d(after[-1], pixels, 1)

    def forward(self, folded: Tensor, evidence: Tensor | None = None) -> Tensor:
        """Return logits; see :meth:`LeanUNet.forward`. The smoothed map is not used."""
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


def make_network(kind: NetworkKind) -> nn.Module:
    """Return an untrained network. Its weights come from torch's global generator."""
    return LeanUNet() if kind == "lean" else EvFlowNet()


def apply_network(network: nn.Module, maps: Tensor, fold: int) -> Tensor:
    """Smooth the maps, convert them to blocks, run the network and convert back.

    Args:
        network: Network of :func:`make_network`.
        maps: ``(n, 1, height, width)`` from 0 to 1.
        fold: Side of a block, px.

    Returns:
        Logits of the same shape.
    """
    line = torch.tensor(SMOOTHING, device=maps.device) / sum(SMOOTHING)
    reach = len(SMOOTHING) // 2
    padded = functional.pad(maps, (reach,) * 4, mode="replicate")
    evidence = functional.conv2d(padded, torch.outer(line, line)[None, None]) - HALF
    folded = (functional.pixel_unshuffle(values, fold) for values in (maps, evidence))
    return functional.pixel_shuffle(network(*folded), fold)
