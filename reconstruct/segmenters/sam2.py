"""The segmenter `sam2`: SAM 2 with weights that the user brings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from reconstruct.priors import sam2
from reconstruct.segmenters.base import Prompt, Segmenter


class Sam2(Segmenter):
    """See `reconstruct.priors.sam2`."""

    name = "sam2"

    def __init__(self) -> None:
        sam2.load_predictor()

    def carry(self, pictures: Sequence[NDArray[np.uint8]], prompts: Sequence[Prompt]) -> NDArray[np.bool_]:
        """See `Segmenter`."""
        return sam2.carry_masks(pictures, prompts)
