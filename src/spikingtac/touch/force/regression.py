"""Forces by two regressions on the shape of the displacement field, in closed form.

A field is its amplitude times its shape. Shear forces and moments are the amplitude times a
function of the shape. The normal force grows faster than the amplitude where a contact spreads, and
never pulls: its logarithm is an exponent times the logarithm of the amplitude, plus a function of
the shape, so that contacts wider than any that was learned are extrapolated as a power law. Within
the range that was learned the normal force is also told like the shear forces, and averaged.

The function is the mean of two: a ridge regression on the quadratic features of the shape, which
extrapolates well, and a Gaussian process (C. E. Rasmussen and C. K. I. Williams, "Gaussian
Processes for Machine Learning", MIT Press 2006, section 8.3.1), whose kernel adds to them a
Gaussian of shape and amplitude; it interpolates well. Half their difference is the spread.
"""

from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.linalg import polar, solve
from scipy.spatial.distance import cdist

from spikingtac.calibration.lens import marker_pitch_px
from spikingtac.touch.network import graph
from spikingtac.types import FloatArray

NORMAL = 2  # Component of the normal force in a wrench.
TINY = 1e-12  # Least variance of a force that is divided by, N squared.

# Weight of one factor for all components beside the frames', in frames: a few presses do not tell a
# whole map (median R2 of the forces, 25 to 500 frames of data/force: 0.79 without, 0.92 with it).
GAIN_PRIOR = 300.0

# Principal shapes that describe a field, and how many of them enter as products (30 to 60 and 16
# to 40 give the same errors between the series of data/force).
MODES, PRODUCT_MODES = 40, 24

# Amplitude below which a field has little shape for finding the modes, over the rms.
SMALL_SHARE = 0.16
FLOOR = 0.5  # The same for the regressions (0.3 and 0.5 are alike).
CENTERS = 600  # Frames at which the Gaussians stand, at most (900 are no better).

# Weight of the logarithm of the amplitude beside the shape, in the kernel's distance.
LOG_SHARE = 0.5

# Power of the Gaussian exp(-distance squared / 2) for the shear forces (of 1, 2 and 3 the least
# errors between the series; the logarithm of the normal force errs least with 1).
NARROW = 3

# Penalties on the weights of the quadratic features in the ridge regression and in the process,
# and on those of the Gaussians (the least errors between the series, in steps by three).
SHEAR_PENALTIES, NORMAL_PENALTIES = (5.0, 5.0, 0.1), (0.33, 0.55, 0.033)
JITTER = 1e-7  # Added to the Gaussians' penalty, of its mean, for a stable solution.

# Force added before the logarithm, and the least force that teaches it, over the rms force.
FORCE_FLOOR_SHARE, FORCE_LEAST_SHARE = 0.06, 0.04

# Frames weigh by their normal force to this power: between equal relative errors (0) and equal
# errors in N (2).
ROW_POWER = 0.75
LARGEST_RATIO = 4.0  # Largest normal force that is told, over the largest that was learned.

# Weight of the normal force that is told like the shear forces, and the share of the largest
# learned force at which it has halved. It does not extrapolate. (Mean R2 of halves in time of the
# series of data/force .860 without, .881 with it; of each series from the others .827 and .838.)
DIRECT_WEIGHT, DIRECT_REACH = 0.5, 0.5

# Distance between mirrored markers and the nearest ones, in pitches, up to which a layout is
# symmetric (0.17 in data/force).
SYMMETRIC_PITCHES = 0.35

# Least R2 of the shear forces on the mean displacement: with less the frames are not known.
FOLLOWS_SHARE = 0.6

# Weight of a mirrored frame beside a measured one (0.15 to 0.3 are alike; mean R2 of the normal
# force in halves of the series of data/force .860, without mirrored frames .847).
MIRRORED_WEIGHT = 0.2

# ONNX operations from the fields to wrench and spread, as ``output=Operator(inputs)``.
STEPS = (
    "z=Mul(fields,scale) zz=Mul(z,z) zm=MatMul(zz,mean) aa=Add(zm,floor) a=Sqrt(aa) "
    "shape=Div(z,a) k=MatMul(shape,modes) ki=Gather(k,first) kj=Gather(k,second) kk=Mul(ki,kj) "
    "loga=Log(a) la=Mul(loga,log_share) g=Concat(k,la) gg=Mul(g,g) gs=MatMul(gg,halves) "
    "dot=MatMul(g,centers) near=Sub(dot,half) e=Sub(near,gs) wide=Exp(e) "
    "w2=Mul(wide,wide) narrow=Mul(w2,wide) even=Concat(k,kk,narrow) powers=Concat(loga,k,kk,wide) "
    # Forces and moments that follow the amplitude, by both regressions.
    "r=MatMul(even,ridge) p=MatMul(even,process) ra=Mul(r,a) pa=Mul(p,a) "
    # The normal force by both logarithms, and its mean with the one of the process.
    "l=MatMul(powers,logs) ll=Add(l,levels) lc=Min(ll,cap) lm=MatMul(lc,both) em=Exp(lm) "
    "f=Sub(em,floor_n) fs=Mul(f,sign) pn=MatMul(pa,normal) away=Sub(pn,fs) "
    "fr=Mul(f,per_reach) ff=Mul(fr,fr) f1=Add(ff,one) w=Div(direct,f1) wa=Mul(w,away) "
    "n=Add(fs,wa) nn=MatMul(n,normal_row) "
    "sum=Add(ra,pa) tangent=Mul(sum,others) all=Add(tangent,nn) wrench=Add(all,zero) "
    "le=Exp(lc) ld=MatMul(le,apart) dn=MatMul(ld,normal_row) "
    "ds=Sub(ra,pa) dt=Mul(ds,others) d=Add(dt,dn) spread=Abs(d)"
)


def fit_regression(
    reference: FloatArray, fields: FloatArray, wrench: FloatArray, zero: FloatArray
) -> bytes:
    """Fit both regressions and return them as an ONNX file with ``wrench`` and ``spread``.

    Args:
        reference: ``(m, 2)`` markers at rest.
        fields: ``(n, 2 m)`` displacements of the markers.
        wrench: ``(n, c)`` forces, N, and moments, Nm, c at least 3, from their own zero.
        zero: ``(c,)`` what the labels read without a force; it is added to what is told.
    """
    fields, wrench, weight = with_mirrored(reference, fields, wrench)
    amplitude, quadratic, place, learned = _described(fields)
    centers = place[:: -(-len(fields) // CENTERS)]
    wide, between = _gaussians(place, centers), _gaussians(centers, centers)
    components = wrench.shape[1]

    rows = amplitude * np.hstack([quadratic, wide**NARROW])
    # Mirrored frames teach no moments: the point to which these refer is not known.
    groups = [(np.s_[: NORMAL + 1], weight), (np.s_[NORMAL + 1 :], np.where(weight < 1, 0, weight))]
    linear = [
        _fit(rows, wrench[:, columns], counts, between**NARROW, SHEAR_PENALTIES)
        for columns, counts in groups[: 1 + (components > NORMAL + 1)]
    ]
    learned["ridge"], learned["process"] = np.concatenate(linear, axis=2)

    rows = np.hstack([np.log(amplitude), quadratic, wide])
    learned |= _fit_logarithm(wrench[:, NORMAL], rows, weight, between)
    normal = (np.arange(components) == NORMAL).astype(np.float64)
    learned |= {
        "floor": FLOOR**2, "log_share": LOG_SHARE, "direct": DIRECT_WEIGHT, "one": 1.0,
        "both": [[0.5], [0.5]], "apart": [[0.5], [-0.5]],
        "halves": np.full((centers.shape[1], 1), 0.5), "centers": centers.T,
        "half": 0.5 * (centers**2).sum(axis=1), "others": 0.5 - 0.5 * normal,
        "normal": normal[:, None], "normal_row": normal[None], "zero": zero,
    }  # fmt: skip
    arrays = {name: np.array(value) for name, value in learned.items()}
    return graph(STEPS, arrays, fields.shape[1], {"wrench": components, "spread": components})


def _described(fields: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, dict[str, Any]]:
    """Return what fields ``(n, size)`` look like, and the constants that tell it of other fields.

    That are amplitudes ``(n, 1)``, quadratic features, and places in the kernel's space.
    """
    size, rms = fields.shape[1], float(np.sqrt((fields**2).mean()))
    scaled = fields / rms
    square = (scaled**2).mean(axis=1, keepdims=True)
    shapes = scaled / np.sqrt(square + SMALL_SHARE**2)
    modes = np.linalg.eigh(shapes.T @ shapes)[1][:, ::-1][:, :MODES] / np.sqrt(size)
    count, leading = modes.shape[1], min(PRODUCT_MODES, modes.shape[1])
    squares = np.tile(np.arange(leading, count), (2, 1))
    first, second = np.hstack([np.array(np.triu_indices(leading)), squares])
    amplitude = np.sqrt(square + FLOOR**2)
    along = scaled / amplitude @ modes
    quadratic = np.hstack([along, along[:, first] * along[:, second]])
    place = np.hstack([along, LOG_SHARE * np.log(amplitude)])
    mean = np.full((size, 1), 1.0 / size)
    constants = {"scale": 1.0 / rms, "mean": mean, "modes": modes, "first": first, "second": second}
    return amplitude, quadratic, place, constants


def _gaussians(places: FloatArray, centers: FloatArray) -> FloatArray:
    """Return exp(-distance squared / 2) of places ``(n, k)`` from centres ``(m, k)``."""
    square = (places**2).sum(axis=1)[:, None] + (centers**2).sum(axis=1) - 2.0 * places @ centers.T
    return np.exp(-0.5 * np.maximum(square, 0.0))


def _fit(
    rows: FloatArray,
    targets: FloatArray,
    weight: FloatArray,
    between: FloatArray,
    penalties: tuple[float, float, float],
    free: int = 0,
) -> FloatArray:
    """Return the weights ``(2, f, c)`` in the ridge regression and in the process.

    Those of the Gaussians are 0 in the former.

    Args:
        rows: ``(n, f)`` features, the Gaussians last.
        targets: ``(n, c)`` what is learned.
        weight: ``(n,)`` how much a frame counts.
        between: ``(m, m)`` Gaussians of the centres.
        penalties: In the ridge regression, in the process, and of the Gaussians.
        free: Number of features without a penalty, which come first.
    """
    square = rows.T @ (weight[:, None] * rows)
    wanted, kept = rows.T @ (weight[:, None] * targets), len(square) - len(between)
    found, penalty = np.zeros((2, *wanted.shape)), np.zeros_like(square)
    penalty[kept:, kept:] = penalties[2] * between + JITTER * len(between) * np.eye(len(between))
    for number, size in enumerate((kept, len(square))):
        np.fill_diagonal(penalty[free:kept, free:kept], penalties[number])
        within = (square + penalty)[:size, :size]
        found[number, :size] = solve(within, wanted[:size], assume_a="pos")
    return found


def _fit_logarithm(
    force: FloatArray, rows: FloatArray, weight: FloatArray, between: FloatArray
) -> dict[str, Any]:
    """Return the constants of the normal force; ``logs (f, 2)`` weigh what makes its logarithm.

    Args:
        force: ``(n,)`` normal forces, N.
        rows: ``(n, f)`` the logarithm of the amplitude, the quadratic features, the Gaussians.
        weight: ``(n,)`` how much a frame counts.
        between: ``(m, m)`` Gaussians of the centres.
    """
    sign, size = (-1.0 if force.sum() < 0 else 1.0), float(np.sqrt((force**2).mean()))
    pressing, floor_n = sign * force, FORCE_FLOOR_SHARE * size
    taught, largest = pressing > FORCE_LEAST_SHARE * size, float(pressing.max())
    kept, rows = pressing[taught], rows[taught]
    heavy, target = weight[taught] * (kept / size) ** ROW_POWER, np.log(kept + floor_n)
    center, level = heavy @ rows / heavy.sum(), float(heavy @ target / heavy.sum())
    away = (target - level)[:, None]
    logs = _fit(rows - center, away, heavy, between, NORMAL_PENALTIES, free=1)[..., 0].T
    cap, per_reach = np.log(LARGEST_RATIO * largest + floor_n), 1.0 / (DIRECT_REACH * largest)
    constants = {"cap": cap, "floor_n": floor_n, "sign": sign, "per_reach": per_reach}
    return constants | {"logs": logs, "levels": level - center @ logs}


def with_mirrored(
    reference: FloatArray, fields: FloatArray, wrench: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return frames, wrenches and weights ``(n,)``, with mirror images (x to -x) of the frames.

    A skin whose markers lie symmetrically feels a mirrored contact alike. Where layout or labels
    are not known to be symmetric there are no images. Arguments as of :func:`fit_regression`.
    """
    known, across = np.ones(len(fields)), _force_mirror(fields, wrench[:, :NORMAL])
    mirrored = reference * [-1.0, 1.0] + [2.0 * reference[:, 0].mean(), 0.0]
    off = float(np.sqrt((cdist(mirrored, reference).min(axis=1) ** 2).mean()))
    if across is None or off > SYMMETRIC_PITCHES * marker_pitch_px(reference):
        return fields, wrench, known
    at_mirrored = RBFInterpolator(reference, np.eye(len(reference)))(mirrored)
    image = np.einsum("kj,njc->nkc", at_mirrored, fields.reshape(len(fields), -1, 2))
    image = (image * [-1.0, 1.0]).reshape(fields.shape)
    force = np.zeros(wrench.shape)
    force[:, :NORMAL], force[:, NORMAL] = wrench[:, :NORMAL] @ across.T, wrench[:, NORMAL]
    weight = np.concatenate([known, MIRRORED_WEIGHT * known])
    return np.concatenate([fields, image]), np.concatenate([wrench, force]), weight


def _force_mirror(fields: FloatArray, shear: FloatArray) -> FloatArray | None:
    """Return the mirror ``(2, 2)`` of x in the labels' frame, which may be turned to the markers'.

    None where the shear forces do not follow the mean displacement.
    """
    mean = fields.reshape(len(fields), -1, 2).mean(axis=1)
    rows = np.column_stack([mean, np.ones(len(mean))])
    found = np.linalg.lstsq(rows, shear, rcond=None)[0]
    left = ((shear - rows @ found) ** 2).sum() / ((shear - shear.mean(axis=0)) ** 2).sum()
    if not left < 1.0 - FOLLOWS_SHARE:
        return None
    turn, _ = polar(found[:2].T)
    return np.asarray(turn @ np.diag([-1.0, 1.0]) @ turn.T)


def r_squared(truth: FloatArray, estimate: FloatArray) -> float:
    """Return 1 - (squared errors) / (squared deviations from the mean); 0 for constant truth."""
    spread = float(((truth - truth.mean()) ** 2).sum())
    return 1.0 - float(((truth - estimate) ** 2).sum()) / spread if spread > 0.0 else 0.0


def relative_error(told: FloatArray, truth: FloatArray) -> float:
    """Return the squared errors of the forces, each over its variance."""
    error = ((told - truth)[:, : NORMAL + 1] ** 2).mean(axis=0)
    return float((error / np.maximum(truth[:, : NORMAL + 1].var(axis=0), TINY)).sum())


def fitted_gain(told: FloatArray, wrench: FloatArray) -> FloatArray:
    """Return the linear map ``(c, c)`` from what a model tells to wrenches, both ``(n, c)``."""
    size, force = np.sqrt((told**2).mean(axis=0)) + TINY, np.s_[:, : NORMAL + 1]
    rows, factor = told / size, (told[force] * wrench[force]).sum() / (told[force] ** 2).sum()
    square = rows.T @ rows + GAIN_PRIOR * np.eye(len(size))
    wanted = rows.T @ wrench + GAIN_PRIOR * factor * np.diag(size)
    return np.linalg.solve(square, wanted) / size[:, None]
