"""How well a calibration explains its recording: per marker, in words, and as a refusal."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import CalibrationError
from spikingtac.markers.calibration.corrections import Changes, Evidence, Model, rims
from spikingtac.markers.calibration.layout import Layout

# A marker with few events is measured when its disc explains this share of what the median disc
# explains. (The recorded marker that hardly moves has 0.20, or 0.58 where its corner alone is
# calibrated; two of v2e's whose rests are off by a pixel 0.41 and 0.50, one that is known 0.67.)
FEWEST_EXPLAINED_SHARE = 0.6

# Events beyond the sensor's noise that a marker needs, and the share of the median over all
# markers that is enough in itself.
FEWEST_EVENTS, FEWEST_EVENTS_SHARE = 40.0, 0.25

# A measured marker is doubtful when its disc explains less than this share of the median.
DOUBTFUL_SHARE = 0.5

GRID_EXPLAINED = 0.15  # Median of the explained shares below which no grid of discs was seen.

# Offsets are means over so many states: changes over some presses count, on rims as well.
OFFSET_STATES = 30.0

# What the median of the explained shares is called.
WORDS = ((0.75, "very good"), (0.55, "good"), (0.35, "usable"), (-1.0, "poor"))


MOST_MISSING_SHARE = 1 / 3  # A grid of which more is missing was not found.

MOST_NAMED = 8  # Missing markers that an error names one by one.


@dataclass(frozen=True, slots=True)
class Quality:
    """How well each marker is known.

    Attributes:
        explained: ``(m,)`` share of the pixels' level changes that the marker's disc explains.
        events: ``(m,)`` events near the marker beyond the sensor's noise.
        measured: ``(m,) bool`` whether the recording tells where the marker is.
        doubtful: ``(m,) bool`` measured markers that their disc explains badly.
        word: The quality in a word or two.
    """

    explained: NDArray[np.float64]
    events: NDArray[np.float64]
    measured: NDArray[np.bool_]
    doubtful: NDArray[np.bool_]
    word: str


def judged(evidence: Evidence, model: Model) -> Quality:
    """Separate the markers that a recording shows from those that it does not.

    Raises:
        CalibrationError: Discs on a grid do not explain the events.
    """
    # Discs that keep their shape: a stretch would explain a part of whatever is there.
    model = replace(model, stretch_px=np.zeros_like(model.stretch_px))
    seen = evidence.seen(model)
    change, around = Changes(seen, OFFSET_STATES, 1.0), rims(evidence, model, seen)
    left_over, whole = (
        around.squares(levels, len(model.on))
        for levels in (change.real - change.ideal, change.real)
    )
    explained = (1.0 - left_over / np.maximum(whole, 1e-9)).clip(-1.0, 1.0)
    usual = float(np.median(explained))
    if usual < GRID_EXPLAINED:
        raise CalibrationError(
            f"no grid of markers: discs in rows and columns explain {max(usual, 0.0):.0%} of "
            f"what the pixels saw, where a marker sensor gives {GRID_EXPLAINED:.0%} and more. If "
            "this is one, its markers hardly moved: press or slide until they move by more than "
            "their diameter; or a flicker of the light or noise drowns their events: use direct "
            "current, raise the thresholds (biases); otherwise the recording shows something else"
        )
    above = (model.events[:, :2] - evidence.noise).sum(axis=1)
    busy = above >= FEWEST_EVENTS_SHARE * np.median(above)
    clear = explained >= FEWEST_EXPLAINED_SHARE * usual
    measured = (above >= FEWEST_EVENTS) & (busy | clear)
    usual = float(np.median(explained[measured])) if measured.any() else 0.0
    doubtful = measured & (explained < DOUBTFUL_SHARE * usual)
    word = next(word for least, word in WORDS if usual >= least)
    return Quality(explained, above, measured, doubtful, word)


def refuse_gaps(
    layout: Layout, size: tuple[int, int], missing: NDArray[np.int64], allowed: int | None
) -> None:
    """Refuse a grid of which too many markers are missing.

    Args:
        layout: The layout.
        size: ``(width, height)``.
        missing: Indices of the markers that the recording does not show.
        allowed: How many may be; None allows a third.

    Raises:
        CalibrationError: More are missing; names them and says where to touch.
    """
    most = int(MOST_MISSING_SHARE * len(layout.point)) if allowed is None else allowed
    if layout.shape is None or len(missing) <= most:
        return
    place, (rows, columns) = layout.expected_px, layout.shape
    named = [
        f"{marker_name(index, layout.shape)} "
        f"(expected near x {place[index][0]:.0f}, y {place[index][1]:.0f} px)"
        for index in missing[:MOST_NAMED]
    ]
    more = len(missing) - len(named)
    regions = sorted({region(place[index], size) for index in missing})
    raise CalibrationError(
        f"{len(missing)} of {len(place)} markers of the {rows}x{columns} grid were not "
        f"found: {'; '.join(named)}{f'; and {more} more' if more else ''}. Press or slide on the "
        f"{' and the '.join(regions)} of the skin, until the markers there move by more than their "
        f"diameter, and record again; if they are broken, give --allow-missing {len(missing)}; if "
        "the grid is another, give --grid ROWSxCOLUMNS"
    )


def marker_name(index: int, shape: tuple[int, int] | None) -> str:
    """Return how a person finds a marker: ``row 1, column 2``, or its number where none are.

    Example:
        >>> marker_name(9, (8, 8)), marker_name(9, None)
        ('row 2, column 2', 'marker 9')
    """
    if shape is None:
        return f"marker {index}"
    return f"row {index // shape[1] + 1}, column {index % shape[1] + 1}"


def region(position_px: NDArray[np.float64], size: tuple[int, int]) -> str:
    """Return which ninth of the image a place is in, as ``upper left``.

    Args:
        position_px: ``(2,)`` the place, px.
        size: ``(width, height)``.
    """
    third = np.clip(np.floor(3 * position_px / np.array(size)), 0, 2).astype(int)
    across, down = ("left", "middle", "right")[third[0]], ("upper", "middle", "lower")[third[1]]
    return "middle" if across == down else f"{down} {across}"
