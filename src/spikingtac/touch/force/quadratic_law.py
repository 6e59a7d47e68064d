"""Forces by ridge regression on the shape of the displacement field: closed form, no training.

A field is its amplitude times its shape. Shear forces and moments are the amplitude times a
quadratic function of the shape. The normal force grows faster than the amplitude where a contact
spreads, and never pulls: its logarithm is an exponent times the logarithm of the amplitude, plus a
quadratic function of the shape, so that contacts wider than any that was learned are extrapolated
as a power law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.network import Node, graph

Field = NDArray[np.float64]

NORMAL = 2
"""Component of the normal force in a wrench."""
MODES, PRODUCT_MODES = 40, 24
"""Principal shapes that describe a field, and how many of them enter as products (ours: 30 to 60
and 16 to 40 give the same errors between the series of data/force)."""
SMALL_SHARE = 0.16
"""Amplitude below which a field has little shape for finding the modes, over the rms."""
FLOOR = 0.5
"""The same for the law (ours: 0.1 to 0.5 are alike)."""
SHEAR_PENALTY, NORMAL_PENALTY = 5e-4, 1e-4
"""Ridge penalties per frame (ours: of 1e-5 to 1e-3 these err least between the series)."""
FORCE_FLOOR_SHARE, FORCE_LEAST_SHARE = 0.06, 0.04
"""Force added before the logarithm, and the least force that teaches it, over the rms force."""
ROW_POWER = 0.75
"""Frames weigh by their normal force to this power: between equal relative errors (0) and equal
errors in N (2)."""
LARGEST_RATIO = 4.0
"""Largest normal force that is told, over the largest that was learned."""


@dataclass(frozen=True)
class QuadraticLaw:
    """Weights of the law; fields are in units of ``rms``.

    Attributes:
        rms: Root mean square of the displacements that were learned.
        modes: ``(size, k)`` principal shapes, over the root of ``size``.
        pairs: ``(2, p)`` modes whose product is a feature.
        weights: ``(k + p, c)`` from the features to the components over the amplitude; for the
            normal force to the logarithm.
        exponent: Of the amplitude in the normal force.
        offset: Of that logarithm.
        floor_n: Force added before it.
        cap: Largest logarithm.
        sign: Sign of the normal force in the labels.
    """

    rms: float
    modes: Field
    pairs: NDArray[np.int64]
    weights: Field
    exponent: float
    offset: float
    floor_n: float
    cap: float
    sign: float

    def onnx(self) -> bytes:
        """Return the law as an ONNX file: ``wrench`` and a ``spread`` of zero."""
        size, components = len(self.modes), self.weights.shape[1]
        shear = self.weights.copy()
        shear[:, NORMAL] = 0.0
        unit = np.zeros((1, components))
        unit[0, NORMAL] = self.sign
        scalars = {
            "scale": 1.0 / self.rms, "floor": FLOOR**2, "exponent": self.exponent,
            "offset": self.offset, "cap": self.cap, "floor_n": self.floor_n, "zero": 0.0,
        }  # fmt: skip
        arrays = {
            "mean": np.full((size, 1), 1.0 / size), "modes": self.modes, "shear": shear,
            "normal": self.weights[:, [NORMAL]], "unit": unit,
            "first": self.pairs[0], "second": self.pairs[1],
        }  # fmt: skip
        steps = (
            "z=Mul(fields,scale) zz=Mul(z,z) zzm=MatMul(zz,mean) aa=Add(zzm,floor) a=Sqrt(aa) "
            "shape=Div(z,a) k=MatMul(shape,modes) ki=Gather(k,first) kj=Gather(k,second) "
            "kk=Mul(ki,kj) features=Concat(k,kk) s=MatMul(features,shear) sa=Mul(s,a) "
            "loga=Log(a) pa=Mul(loga,exponent) n=MatMul(features,normal) np=Add(n,pa) "
            "l=Add(np,offset) capped=Min(l,cap) e=Exp(capped) f=Sub(e,floor_n) "
            "fn=MatMul(f,unit) wrench=Add(sa,fn) spread=Mul(wrench,zero)"
        )
        return graph(
            [_node(step) for step in steps.split()],
            {name: np.array(value) for name, value in scalars.items()} | arrays,
            size,
            {"wrench": components, "spread": components},
        )


def _node(step: str) -> Node:
    """Return the operation of ``output=Operator(inputs)``."""
    output, call = step.split("=")
    operator, inputs = call.rstrip(")").split("(")
    integers = {"axis": 1} if operator in ("Gather", "Concat") else {}
    return Node(operator, inputs.split(","), output, integers)


def _features(modes: Field, pairs: NDArray[np.int64], fields: Field) -> tuple[Field, Field]:
    """Return amplitudes ``(n, 1)`` and features ``(n, k + p)`` of fields in units of their rms."""
    amplitude = np.sqrt((fields**2).mean(axis=1, keepdims=True) + FLOOR**2)
    along = fields / amplitude @ modes
    return amplitude, np.hstack([along, along[:, pairs[0]] * along[:, pairs[1]]])


def fit_quadratic(fields: Field, wrench: Field) -> QuadraticLaw:
    """Fit the law to fields ``(n, size)`` and their wrenches ``(n, c)``, c at least 3."""
    rms = float(np.sqrt((fields**2).mean()))
    scaled, force = fields / rms, wrench[:, NORMAL]
    shapes = scaled / np.sqrt((scaled**2).mean(axis=1, keepdims=True) + SMALL_SHARE**2)
    _, vectors = np.linalg.eigh(shapes.T @ shapes)
    modes = vectors[:, ::-1][:, :MODES] / np.sqrt(fields.shape[1])
    leading, count = min(PRODUCT_MODES, modes.shape[1]), modes.shape[1]
    squares = np.tile(np.arange(leading, count), (2, 1))
    pairs = np.hstack([np.array(np.triu_indices(leading)), squares])
    amplitude, features = _features(modes, pairs, scaled)
    weights = _ridge(amplitude * features, wrench, SHEAR_PENALTY * len(fields))

    sign, size = (-1.0 if force.sum() < 0 else 1.0), float(np.sqrt((force**2).mean()))
    pressing, floor_n = sign * force, FORCE_FLOOR_SHARE * size
    taught = pressing > FORCE_LEAST_SHARE * size
    rows = np.hstack([np.log(amplitude), features])[taught]
    heavy = pressing[taught, None] ** ROW_POWER
    target = np.log(pressing[taught, None] + floor_n)
    center = (heavy * rows).sum(axis=0) / heavy.sum()
    level = float((heavy * target).sum() / heavy.sum())
    penalty = np.full(rows.shape[1], NORMAL_PENALTY * len(rows))
    penalty[0] = 0.0
    root = np.sqrt(heavy)
    normal = _ridge(root * (rows - center), root * (target - level), penalty)[:, 0]
    weights[:, NORMAL] = normal[1:]
    cap = float(np.log(LARGEST_RATIO * pressing.max() + floor_n))
    offset = level - float(center @ normal)
    return QuadraticLaw(rms, modes, pairs, weights, float(normal[0]), offset, floor_n, cap, sign)


def _ridge(rows: Field, targets: Field, penalty: float | Field) -> Field:
    """Return the weights ``(f, c)`` of a ridge regression."""
    square = rows.T @ rows + np.diag(np.broadcast_to(penalty, rows.shape[1]))
    return np.asarray(np.linalg.solve(square, rows.T @ targets), np.float64)
