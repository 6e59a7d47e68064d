"""The loss of the denoiser. It needs events only.

The paper refers to "the loss formulations in NeuTac", of which no publication could be found. The
photometric loss of EV-FlowNet needs camera frames, which this sensor does not have. This loss is
the project's own; see ``docs/explanation/denoising.md``.
"""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional


def prediction_error(logits: Tensor, target: Tensor) -> Tensor:
    """Return the cross-entropy between the denoised map and another map of the same moment.

    Its minimum is the expectation of the target for the given input, whatever the noise of the
    target, as long as that noise is independent (J. Lehtinen et al., "Noise2Noise", ICML 2018,
    arXiv:1803.04189). Pixels that only chance connects get the same prediction, so that the network
    cannot copy noise.

    Args:
        logits: ``(n, 1, height, width)``.
        target: Same shape, from 0 to 1.
    """
    return functional.binary_cross_entropy_with_logits(logits, target)
