"""Interface of a segmenter: the object in all frames, from what is known of some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Prompt:
    """What is known of one frame: a mask, or clicks."""

    frame: int
    mask: NDArray[np.bool_] | None = None
    """(h, w) the object."""
    clicks: tuple[tuple[float, float, bool], ...] = ()
    """Column, row, and whether the object is there."""


class Segmenter:
    """Carries masks along a video. The constructor loads the weights; FreeArtError says what is missing."""

    name: ClassVar[str]

    def carry(self, pictures: Sequence[NDArray[np.uint8]], prompts: Sequence[Prompt]) -> NDArray[np.bool_]:
        """(n, h, w) the object in n RGB pictures (h, w, 3), from what is known of some frames."""
        raise NotImplementedError
