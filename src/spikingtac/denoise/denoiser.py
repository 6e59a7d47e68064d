"""The protocol of every denoiser: none, classical filter or network."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Denoiser(Protocol):
    """Turns a noisy state map into a denoised one of the same shape."""

    def clean(self, state_map: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the denoised map.

        Args:
            state_map: ``(height, width)`` float32 from 0 (ground) to 1 (marker).

        Returns:
            ``(height, width)`` float32 from 0 to 1. The next call may overwrite it.
        """
        ...
