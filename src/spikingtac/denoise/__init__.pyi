"""Public names of the room ``denoise``."""

from .blocks import LEVELS as LEVELS
from .classical import Median3 as Median3
from .classical import Denoiser as Denoiser
from .infer import ANSWER as ANSWER
from .infer import BLOCKS as BLOCKS
from .infer import EVIDENCE as EVIDENCE
from .infer import FORMAT as FORMAT
from .infer import INPUT as INPUT
from .infer import LOGIT_STEP as LOGIT_STEP
from .infer import LOGIT_ZERO as LOGIT_ZERO
from .infer import MANIFEST as MANIFEST
from .infer import NetworkDenoiser as NetworkDenoiser
from .infer import OUTPUT as OUTPUT
from .classical import make_denoiser as make_denoiser
