"""Losses that need events only.

The paper says "the loss formulations in NeuTac", which are not published in any place that could be
found, and EV-FlowNet's photometric loss needs camera frames, which this sensor has not. These are
the project's own; ``docs/explanation/denoising.md`` gives each term and what it was found to do.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

SMOOTH_PX = 9
"""Side of the box whose means :func:`smooth_error` compares: about a marker's radius and a bit."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LossConfig:
    """Weights of the terms; the first, the prediction error, weighs 1.

    Attributes:
        smooth: Weight of :func:`smooth_error`.
        binarity: Weight of :func:`binarity`.
        variation: Weight of :func:`total_variation`.
    """

    smooth: float = 0.0
    binarity: float = 0.0
    variation: float = 0.0

    def __post_init__(self) -> None:
        if min(self.smooth, self.binarity, self.variation) < 0:
            raise ValueError("weights of loss terms must not be negative")


def prediction_error(logits: Tensor, target: Tensor) -> Tensor:
    """Cross-entropy between the cleaned map and another map of the same moment.

    Its minimum is the expectation of the target given the input, whatever the target's own noise,
    as long as that noise is independent (J. Lehtinen et al., "Noise2Noise", ICML 2018,
    arXiv:1803.04189): pixels that nothing but chance connects are predicted alike, so noise cannot
    be copied.

    Args:
        logits: ``(n, 1, height, width)``.
        target: The same shape, from 0 to 1.
    """
    return functional.binary_cross_entropy_with_logits(logits, target)


def smooth_error(cleaned: Tensor, target: Tensor) -> Tensor:
    """Squared difference of local means: errors that move a marker's centroid, not single pixels.

    Args:
        cleaned: ``(n, 1, height, width)`` from 0 to 1.
        target: The same shape.
    """
    return functional.avg_pool2d(cleaned - target, SMOOTH_PX, 1).square().mean()


def binarity(cleaned: Tensor) -> Tensor:
    """Mean of q (1 - q): zero where every pixel is decided, 1/4 where none is."""
    return (cleaned * (1.0 - cleaned)).mean()


def total_variation(cleaned: Tensor) -> Tensor:
    """Mean absolute difference of neighbours: the length of all rims, so lone pixels cost most."""
    across = (cleaned[..., 1:] - cleaned[..., :-1]).abs().mean()
    down = (cleaned[..., 1:, :] - cleaned[..., :-1, :]).abs().mean()
    return across + down


def loss_terms(logits: Tensor, target: Tensor, config: LossConfig) -> dict[str, Tensor]:
    """Return each term with its weight applied, and their sum as ``loss``."""
    cleaned = torch.sigmoid(logits)
    terms = {"prediction": prediction_error(logits, target)}
    if config.smooth:
        terms["smooth"] = config.smooth * smooth_error(cleaned, target)
    if config.binarity:
        terms["binarity"] = config.binarity * binarity(cleaned)
    if config.variation:
        terms["variation"] = config.variation * total_variation(cleaned)
    return {**terms, "loss": torch.stack(list(terms.values())).sum()}
