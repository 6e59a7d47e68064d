"""Forces by two regressions on the shape of the displacement field, in closed form.

A field is its amplitude times its shape. Shear forces and moments are the amplitude times a
function of the shape. The normal force grows faster than the amplitude where a contact spreads, and
never pulls: its logarithm is an exponent times the logarithm of the amplitude, plus a function of
the shape, so that contacts wider than any that was learned are extrapolated as a power law.

The function is the mean of two: a ridge regression on the quadratic features of the shape, which
extrapolates well, and a Gaussian process (C. E. Rasmussen and C. K. I. Williams, "Gaussian
Processes for Machine Learning", MIT Press 2006, section 8.3.1), whose kernel adds to them a
Gaussian of shape and amplitude; it interpolates well. Half their difference is the spread.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

from spikingtac.touch.network import Node, graph

Field = NDArray[np.float64]

NORMAL = 2  # Component of the normal force in a wrench.

# Principal shapes that describe a field, and how many of them enter as products (ours: 30 to 60
# and 16 to 40 give the same errors between the series of data/force).
MODES, PRODUCT_MODES = 40, 24

# Amplitude below which a field has little shape for finding the modes, over the rms.
SMALL_SHARE = 0.16
FLOOR = 0.5  # The same for the regressions (ours: 0.3 and 0.5 are alike).

# Frames at which the Gaussians of the kernel stand, at most (ours: 900 are no better).
CENTERS = 600

# Weight of the logarithm of the amplitude beside the shape, in the kernel's distance.
LOG_SHARE = 0.5

# Power of the Gaussian exp(-distance squared / 2) for the shear forces (ours: of 1, 2 and 3 the
# least errors between the series; the normal force errs least with 1).
NARROW = 3

# Penalties on the weights of the quadratic features in the ridge regression and in the process,
# and on those of the Gaussians (ours: the least errors between the series, in steps by three).
SHEAR_PENALTIES, NORMAL_PENALTIES = (5.0, 5.0, 0.1), (0.33, 0.55, 0.033)
JITTER = 1e-7  # Added to the Gaussians' penalty, of its mean, for a stable solution.

# Force added before the logarithm, and the least force that teaches it, over the rms force.
FORCE_FLOOR_SHARE, FORCE_LEAST_SHARE = 0.06, 0.04

# Frames weigh by their normal force to this power: between equal relative errors (0) and equal
# errors in N (2).
ROW_POWER = 0.75
LARGEST_RATIO = 4.0  # Largest normal force that is told, over the largest that was learned.

# ONNX operations from the fields to wrench and spread, as ``output=Operator(inputs)``.
STEPS = (
    "z=Mul(fields,scale) zz=Mul(z,z) zm=MatMul(zz,mean) aa=Add(zm,floor) a=Sqrt(aa) "
    "shape=Div(z,a) k=MatMul(shape,modes) ki=Gather(k,first) kj=Gather(k,second) kk=Mul(ki,kj) "
    "loga=Log(a) la=Mul(loga,log_share) g=Concat(k,la) gg=Mul(g,g) gs=MatMul(gg,halves) "
    "dot=MatMul(g,centers) near=Sub(dot,half) e=Sub(near,gs) wide=Exp(e) "
    "w2=Mul(wide,wide) narrow=Mul(w2,wide) features=Concat(k,kk,loga,wide,narrow) "
    "r=MatMul(features,ridge) p=MatMul(features,process) ra=Mul(r,a) pa=Mul(p,a) "
    "rn=MatMul(r,normal) pn=MatMul(p,normal) rl=Add(rn,level_r) pl=Add(pn,level_p) "
    "rc=Min(rl,cap) pc=Min(pl,cap) ln=Add(rc,pc) lm=Mul(ln,share) em=Exp(lm) "
    "f=Sub(em,floor_n) fn=MatMul(f,signed) shear=Add(ra,pa) tangent=Mul(shear,others) "
    "both=Add(tangent,fn) wrench=Add(both,zero) "
    "er=Exp(rc) ep=Exp(pc) dn=Sub(er,ep) dnu=MatMul(dn,signed) ds=Sub(ra,pa) dso=Mul(ds,others) "
    "dnh=Mul(dnu,share) d=Add(dso,dnh) spread=Abs(d)"
)


class _Described(NamedTuple):
    """Fields by amplitude ``(n, 1)``, quadratic features, and place in the kernel's space."""

    amplitude: Field
    features: Field
    place: Field


class _Shapes(NamedTuple):
    """Scale, principal shapes ``(size, k)`` and products ``(2, p)`` that describe fields."""

    rms: float
    modes: Field
    pairs: NDArray[np.int64]

    @classmethod
    def of(cls, fields: Field) -> _Shapes:
        """Find the principal shapes of fields ``(n, size)``."""
        rms = float(np.sqrt((fields**2).mean()))
        scaled = fields / rms
        shapes = scaled / np.sqrt((scaled**2).mean(axis=1, keepdims=True) + SMALL_SHARE**2)
        _, vectors = np.linalg.eigh(shapes.T @ shapes)
        modes = vectors[:, ::-1][:, :MODES] / np.sqrt(fields.shape[1])
        leading, count = min(PRODUCT_MODES, modes.shape[1]), modes.shape[1]
        squares = np.tile(np.arange(leading, count), (2, 1))
        return cls(rms, modes, np.hstack([np.array(np.triu_indices(leading)), squares]))

    def describe(self, fields: Field) -> _Described:
        """Describe fields ``(n, size)``."""
        scaled = fields / self.rms
        amplitude = np.sqrt((scaled**2).mean(axis=1, keepdims=True) + FLOOR**2)
        along = scaled / amplitude @ self.modes
        products = along[:, self.pairs[0]] * along[:, self.pairs[1]]
        place = np.hstack([along, LOG_SHARE * np.log(amplitude)])
        return _Described(amplitude, np.hstack([along, products]), place)


def _gaussians(places: Field, centers: Field) -> Field:
    """Return exp(-distance squared / 2) of places ``(n, k)`` from centres ``(m, k)``."""
    square = (places**2).sum(axis=1)[:, None] + (centers**2).sum(axis=1) - 2.0 * places @ centers.T
    return np.exp(-0.5 * np.maximum(square, 0.0))


def _fit(rows: Field, targets: Field, weight: Field, penalty: Field, gaussians: int) -> Field:
    """Return the weights ``(2, f, c)`` in the ridge regression and in the process.

    Those of the Gaussians are 0 in the former.

    Args:
        rows: ``(n, f)`` features, the Gaussians last.
        targets: ``(n, c)`` what is learned.
        weight: ``(n,)`` how much a frame counts.
        penalty: ``(2, f, f)`` on the weights in the ridge regression and in the process.
        gaussians: Number of Gaussians.
    """
    square = rows.T @ (weight[:, None] * rows)
    wanted, kept = rows.T @ (weight[:, None] * targets), len(square) - gaussians
    found = np.zeros((2, *wanted.shape))
    found[0, :kept] = solve((square + penalty[0])[:kept, :kept], wanted[:kept], assume_a="pos")
    found[1] = solve(square + penalty[1], wanted, assume_a="pos")
    return found


def _penalties(
    free: int, quadratic: int, amounts: tuple[float, float, float], between: Field
) -> Field:
    """Return the penalties ``(2, f, f)`` of both regressions on free, quadratic, near features.

    Args:
        free: Number of features without a penalty, which come first.
        quadratic: Number of quadratic features.
        amounts: Penalties: in the ridge regression, in the process, and of the Gaussians.
        between: ``(m, m)`` Gaussians of the centres.
    """
    jitter = JITTER * len(between) * np.eye(len(between))
    size = free + quadratic + len(between)
    out = np.zeros((2, size, size))
    for penalty, amount in zip(out, amounts[:2], strict=True):
        penalty[free : free + quadratic, free : free + quadratic] = amount * np.eye(quadratic)
        penalty[free + quadratic :, free + quadratic :] = amounts[2] * between + jitter
    return out


def fit_regression(fields: Field, wrench: Field, weight: Field, zero: Field) -> bytes:
    """Fit both regressions and return them as an ONNX file with ``wrench`` and ``spread``.

    Args:
        fields: ``(n, size)`` displacements of the markers.
        wrench: ``(n, c)`` forces, N, and moments, Nm, c at least 3, from their own zero.
        weight: ``(n, c)`` how much a frame counts for a component, alike for both shear forces and
            for all moments.
        zero: ``(c,)`` what the labels read without a force; it is added to what is told.
    """
    shapes = _Shapes.of(fields)
    amplitude, quadratic, place = shapes.describe(fields)
    centers = place[:: -(-len(fields) // CENTERS)]
    wide, between = _gaussians(place, centers), _gaussians(centers, centers)
    count, components = quadratic.shape[1], wrench.shape[1]
    logarithm, narrow = count, slice(count + 1 + len(centers), None)
    learned = np.zeros((2, count + 1 + 2 * len(centers), components))

    penalty = _penalties(0, count, SHEAR_PENALTIES, between**NARROW)
    rows = amplitude * np.hstack([quadratic, wide**NARROW])
    for first, last in ((0, NORMAL), (NORMAL + 1, components)):
        if first < last:
            found = _fit(rows, wrench[:, first:last], weight[:, first], penalty, len(centers))
            learned[:, :count, first:last] = found[:, :count]
            learned[:, narrow, first:last] = found[:, count:]

    pressing = _Pressing.of(wrench[:, NORMAL])
    heavy = weight[pressing.taught, NORMAL] * pressing.weight
    rows = np.hstack([np.log(amplitude), quadratic, wide])[pressing.taught]
    center, level = heavy @ rows / heavy.sum(), float(heavy @ pressing.target / heavy.sum())
    penalty = _penalties(1, count, NORMAL_PENALTIES, between)
    target = (pressing.target - level)[:, None]
    found = _fit(rows - center, target, heavy, penalty, len(centers))[..., 0]
    learned[:, :count, NORMAL] = found[:, 1 : count + 1]
    learned[:, logarithm, NORMAL] = found[:, 0]
    learned[:, count + 1 : narrow.start, NORMAL] = found[:, count + 1 :]
    return _onnx(shapes, centers, learned, level - found @ center, pressing, zero)


class _Pressing(NamedTuple):
    """The normal forces that teach: which frames, their logarithms and weights, and the scale."""

    taught: NDArray[np.bool_]
    target: Field
    weight: Field
    floor_n: float
    cap: float
    sign: float

    @classmethod
    def of(cls, force: Field) -> _Pressing:
        """Prepare normal forces ``(n,)``."""
        sign, size = (-1.0 if force.sum() < 0 else 1.0), float(np.sqrt((force**2).mean()))
        pressing, floor_n = sign * force, FORCE_FLOOR_SHARE * size
        taught = pressing > FORCE_LEAST_SHARE * size
        cap = float(np.log(LARGEST_RATIO * pressing.max() + floor_n))
        kept = pressing[taught]
        return cls(taught, np.log(kept + floor_n), (kept / size) ** ROW_POWER, floor_n, cap, sign)


def _onnx(
    shapes: _Shapes, centers: Field, learned: Field, level: Field, pressing: _Pressing, zero: Field
) -> bytes:
    """Return the regressions as an ONNX file.

    ``others`` halves the sum of the two for all components but the normal force.
    """
    size, components = len(shapes.modes), learned.shape[2]
    normal = np.arange(components) == NORMAL
    scalars = {
        "scale": 1.0 / shapes.rms, "floor": FLOOR**2, "log_share": LOG_SHARE, "share": 0.5,
        "cap": pressing.cap, "floor_n": pressing.floor_n,
    }  # fmt: skip
    arrays = {
        "mean": np.full((size, 1), 1.0 / size), "modes": shapes.modes,
        "first": shapes.pairs[0], "second": shapes.pairs[1],
        "halves": np.full((centers.shape[1], 1), 0.5), "centers": centers.T,
        "half": 0.5 * (centers**2).sum(axis=1), "others": np.where(normal, 0.0, 0.5),
        "ridge": learned[0], "process": learned[1], "level_r": level[:1], "level_p": level[1:],
        "normal": 1.0 * normal[:, None], "signed": pressing.sign * normal[None], "zero": zero,
    }  # fmt: skip
    return graph(
        [_node(step) for step in STEPS.split()],
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
