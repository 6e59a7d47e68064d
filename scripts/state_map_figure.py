"""The paper's state-map figure: events rebuild a marker once it has moved by its diameter.

Run: python scripts/state_map_figure.py [state_map.png]
"""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from spikingtac.markers.blobs import find_blobs
from spikingtac.state_map.binary import BinaryStateMap, paint_discs
from spikingtac.types import EventPacket

SIZE = (64, 32)
RADIUS_PX = 7.0
CONTRAST = 6.0  # white marker over black skin
THRESHOLD = 0.25  # change of log intensity that makes one event
STEPS = 140  # 0.1 px each, one diameter in all

state_map = BinaryStateMap(SIZE)
radius = np.array([RADIUS_PX])


def log_intensity(x_px: float) -> np.ndarray:
    """Return what the pixels see of a marker at x_px."""
    cover = paint_discs(SIZE, np.array([[x_px, 16.0]]), radius)
    return np.log(1.0 + (CONTRAST - 1.0) * cover)


seen = log_intensity(16.0)  # what each pixel compares with: the marker at rest, not yet in the map
figure, axes = plt.subplots(1, 4, figsize=(12, 2.2), layout="constrained")
for step in range(1, STEPS + 1):
    x_px = 16.0 + 2.0 * RADIUS_PX * step / STEPS
    crossings = np.trunc((log_intensity(x_px) - seen) / THRESHOLD)
    seen += crossings * THRESHOLD
    y, x = np.nonzero(crossings)
    on = crossings[y, x] > 0
    t = np.full(len(x), step, np.int64)
    state_map.absorb(
        EventPacket(x.astype(np.uint16), y.astype(np.uint16), on, t, step, step + 1, SIZE)
    )
    if step % (STEPS // 4) == 0:
        blobs = find_blobs(state_map.values)
        axis = axes[4 * step // STEPS - 1]
        axis.imshow(state_map.values, cmap="gray", vmin=0, vmax=1)
        axis.add_patch(plt.Circle((x_px, 16.0), RADIUS_PX, fill=False, color="tab:red"))
        axis.set(title=f"{step / STEPS:.0%} of the diameter", xticks=[], yticks=[])
        area = f"{blobs.area_px[0] / (np.pi * RADIUS_PX**2):.0%}" if len(blobs) else "none"
        print(f"moved {x_px - 16.0:4.1f} px: {area} of the marker's area rebuilt")

target = sys.argv[1] if len(sys.argv) > 1 else "state_map.png"
figure.savefig(target, dpi=100)
print(f"wrote {target} (red: where the marker truly is; the map runs ahead of it)")
