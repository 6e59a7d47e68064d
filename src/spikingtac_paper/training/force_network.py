"""The force network: the quadratic law and five networks on the field's shape, in one mean.

All of them see a field as amplitude and shape, so that light and firm contacts are alike, and all
tell the logarithm of the normal force. They err in different ways: the law extrapolates, the
networks know the bends within what was learned.
"""

from __future__ import annotations

from math import log

import numpy as np
import torch
from numpy.typing import NDArray

from spikingtac.touch import FLOOR, NORMAL, QuadraticLaw
from spikingtac_paper.training.small_networks import Schedule, export, fit

Field = NDArray[np.float64]

MEMBERS, WIDTHS = 5, (256, 128)
"""Networks, and the widths of their layers."""
LAW_SHARE, LAW_NORMAL_SHARE = 0.5, 0.7
"""Share of the quadratic law in the mean: of shear and moments, and of the logarithm of the normal
force, which the law extrapolates better (ours: R2 between the series of data/force)."""
MEMBER_FLOOR = 0.2
"""Amplitude below which a field has little shape for the networks, over the rms."""
DROPOUT = 0.2
NOISE = 0.05
"""Noise on the fields while learning, over their rms (0.03 mm of 0.6 mm)."""
BATCH = 128
SCHEDULE = Schedule(rate=2e-3, decay=1e-3, epochs=60)
LEAST_FORCE = 0.3
"""Force, over its deviation, below which errors count as at it: above, relative errors count."""
SEED = 0


class ShapeNetworks(torch.nn.Module):
    """Members side by side, each from shape and amplitude to the wrench."""

    def __init__(self, size: int, wrench: torch.Tensor, sign: float) -> None:
        """Draw the weights; the outputs begin at the mean force.

        Args:
            size: Numbers of a field.
            wrench: ``(n, c)`` what is learned.
            sign: Sign of the normal force.
        """
        super().__init__()
        components, before = wrench.shape[1], size + 1
        layers = []
        for width in (*WIDTHS, components):
            bound = before**-0.5
            weights = torch.empty(MEMBERS, before, width).uniform_(-bound, bound)
            layers.append(torch.nn.Parameter(weights if width != components else 0.0 * weights))
            before = width
        self.layers = torch.nn.ParameterList(layers)
        self.biases = torch.nn.ParameterList(
            [torch.nn.Parameter(torch.zeros(MEMBERS, 1, one.shape[2])) for one in layers]
        )
        self.direct = torch.nn.Parameter(torch.zeros(MEMBERS, size, components))
        self.powers = torch.nn.Parameter(torch.ones(MEMBERS, 1, 2))
        self.register_buffer("deviation", wrench.std(dim=0))
        self.level = log(float((sign * wrench[:, NORMAL]).mean()))

    def forward(self, fields: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return wrenches and logarithms of the normal force of fields ``(n, size)`` over the rms.

        The first have a normal force of no meaning.
        """
        amplitude = (fields.square().mean(dim=1, keepdim=True) + MEMBER_FLOOR**2).sqrt()
        shape = fields / amplitude
        values = torch.cat([shape, 0.5 * amplitude.log()], dim=1)[None]
        for weights, bias in zip(self.layers[:-1], self.biases[:-1], strict=True):
            bent = torch.nn.functional.silu(torch.matmul(values, weights) + bias)
            values = torch.nn.functional.dropout(bent, DROPOUT, self.training)
        told = torch.matmul(values, self.layers[-1]) + self.biases[-1]
        told = told + torch.matmul(shape[None], self.direct)
        shear = torch.exp(self.powers[..., :1] * amplitude.log()) * told * self.deviation
        normal = self.powers[..., 1:] * amplitude.log() + told[..., [NORMAL]] + self.level
        return shear, normal


class ForceNetwork(torch.nn.Module):
    """What runs: fields in their own unit in, the mean wrench and the members' spread out."""

    modes: torch.Tensor
    weights: torch.Tensor
    pairs: torch.Tensor

    def __init__(self, law: QuadraticLaw, members: ShapeNetworks) -> None:
        """Join the law and the members."""
        super().__init__()
        self.law, self.members = law, members
        self.register_buffer("modes", torch.tensor(law.modes, dtype=torch.float32))
        self.register_buffer("weights", torch.tensor(law.weights, dtype=torch.float32))
        self.register_buffer("pairs", torch.tensor(law.pairs))

    def forward(self, fields: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return wrenches ``(n, c)`` and the spreads of the parts of the mean."""
        law, scaled = self.law, fields / self.law.rms
        amplitude = (scaled.square().mean(dim=1, keepdim=True) + FLOOR**2).sqrt()
        along = torch.matmul(scaled / amplitude, self.modes)
        products = along[:, self.pairs[0]] * along[:, self.pairs[1]]
        told = torch.matmul(torch.cat([along, products], dim=1), self.weights)
        logarithm = told[:, [NORMAL]] + law.exponent * amplitude.log() + law.offset
        shear, normal = self.members(scaled)
        normal = normal.clamp(max=law.cap)
        sheared = LAW_SHARE * amplitude * told + (1.0 - LAW_SHARE) * shear.mean(dim=0)
        pressed = LAW_NORMAL_SHARE * logarithm.clamp(max=law.cap)
        pressed = pressed + (1.0 - LAW_NORMAL_SHARE) * normal.mean(dim=0)
        force = law.sign * (torch.exp(pressed) - law.floor_n)
        wrench = torch.cat([sheared[:, :NORMAL], force, sheared[:, NORMAL + 1 :]], dim=1)
        each = law.sign * (torch.exp(normal) - law.floor_n)
        every = torch.cat([shear[..., :NORMAL], each, shear[..., NORMAL + 1 :]], dim=2)
        return wrench, (every - wrench[None]).square().mean(dim=0).sqrt()


def train_force(fields: Field, wrench: Field, law: QuadraticLaw) -> bytes:
    """Return the network as an ONNX file with outputs ``wrench`` and ``spread``.

    Args:
        fields: ``(n, size)`` displacements of the markers.
        wrench: ``(n, c)`` forces, N, and moments, Nm.
        law: The quadratic law of the same frames.
    """
    torch.manual_seed(SEED)
    rows = torch.tensor(fields / law.rms, dtype=torch.float32)
    truth = torch.tensor(wrench, dtype=torch.float32)
    members = ShapeNetworks(rows.shape[1], truth, law.sign)
    deviation = truth.std(dim=0).clamp(min=1e-9)
    batch = min(BATCH, len(rows))

    def batches() -> list[torch.Tensor]:
        order = torch.randperm(len(rows))
        return list(order[: len(rows) // batch * batch].split(batch))

    def loss(network: torch.nn.Module, chosen: torch.Tensor) -> torch.Tensor:
        shear, normal = network(rows[chosen] + NOISE * torch.randn(batch, rows.shape[1]))
        force = law.sign * (torch.exp(normal) - law.floor_n)
        told = torch.cat([shear[..., :NORMAL], force, shear[..., NORMAL + 1 :]], dim=2)
        wanted = truth[chosen] / deviation
        size = LEAST_FORCE + wanted[:, :3].norm(dim=1, keepdim=True)
        return (((told / deviation - wanted) / size).square().mean(dim=(1, 2))).sum()

    fit(members, batches, loss, SCHEDULE)
    example = {"fields": torch.zeros(1, rows.shape[1])}
    return export(ForceNetwork(law, members), example, ("wrench", "spread"), {})
