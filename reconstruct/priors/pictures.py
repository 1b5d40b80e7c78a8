"""Crops as networks take them: enlarged to a multiple of their stride, 0 to 1, and pixels back."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of red, green and blue, from 0 to 1."""


def enlarge(picture: NDArray[np.uint8], enlargement: float, stride: int) -> NDArray[np.uint8]:
    """A picture (h, w, 3) `enlargement` times as large, each side rounded to a multiple of `stride` pixels."""
    sides = [max(round(side * enlargement / stride), 1) * stride for side in picture.shape[:2]]
    return np.asarray(cv2.resize(picture, (sides[1], sides[0]), interpolation=cv2.INTER_LINEAR), np.uint8)


def to_tensor(picture: NDArray[np.uint8]) -> Any:
    """(1, 3, h, w) from 0 to 1, of a picture (h, w, 3) in RGB."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(picture)).permute(2, 0, 1)[None].float() / 255


def normalise(picture: Any) -> Any:
    """(1, 3, h, w) from 0 to 1, minus ImageNet's mean, over its standard deviation."""
    import torch

    mean, std = (torch.tensor(values).reshape(1, 3, 1, 1) for values in (IMAGENET_MEAN, IMAGENET_STD))
    return (picture - mean) / std


def to_crop(at: NDArray[Any], picture: NDArray[np.uint8], enlarged: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Columns and rows (m, 2) in `enlarged` as those in `picture`; whole numbers are pixel centres in both."""
    ratio = np.array(picture.shape[1::-1]) / np.array(enlarged.shape[1::-1])
    return np.asarray((np.asarray(at, float) + 0.5) * ratio - 0.5)
