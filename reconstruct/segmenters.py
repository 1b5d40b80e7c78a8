"""Networks that carry masks along a video, from what is known of some frames."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from reconstruct.priors.weights import BroughtWeights, Checkout, inference, load_into

CHECKOUT = Checkout("sam2", "https://github.com/facebookresearch/sam2")
SOURCE = "https://github.com/facebookresearch/sam2 (Apache-2.0)"
FILES = (
    (BroughtWeights("sam2.1_hiera_tiny.pt", SOURCE), "configs/sam2.1/sam2.1_hiera_t.yaml"),
    (BroughtWeights("sam2.1_hiera_small.pt", SOURCE), "configs/sam2.1/sam2.1_hiera_s.yaml"),
    (BroughtWeights("sam2.1_hiera_base_plus.pt", SOURCE), "configs/sam2.1/sam2.1_hiera_b+.yaml"),
    (BroughtWeights("sam2.1_hiera_large.pt", SOURCE), "configs/sam2.1/sam2.1_hiera_l.yaml"),
)
"""Published files and their configurations, small to large; the largest that is there is taken."""
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 98, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
"""Colours of every pixel: an outline is not blurred."""
OBJECT = 1


@dataclass(frozen=True)
class Prompt:
    """What is known of one frame: a mask, or clicks."""

    frame: int
    mask: NDArray[np.bool_] | None = None
    """(h, w) the object."""
    clicks: tuple[tuple[float, float, bool], ...] = ()
    """Column, row, and whether the object is there."""


@lru_cache(1)
def load_predictor() -> Any:
    """SAM 2's video predictor with its weights, on a GPU where there is one; FreeArtError says what is missing."""
    brought, config = next((known for known in reversed(FILES) if known[0].is_there()), FILES[0])
    weights = brought.read()
    import torch

    build = CHECKOUT.load_module("sam2.build_sam").build_sam2_video_predictor
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return load_into(build(config, None, device=device), weights.get("model", weights), brought.file)


class Sam2:
    """SAM 2 (Ravi et al. 2024), by the user's own weights.

    Read in facebookresearch/sam2 at 2b90b9f (sam2/build_sam.py, sam2_video_predictor.py, utils/misc.py): a folder of
    pictures `00000.jpg`, ... is the video; `add_new_mask` takes a mask of the video's own size, `add_new_points_or_box`
    columns and rows with labels 1 (object) or 0; `propagate_in_video` gives frame, objects and logits (1, 1, h, w),
    above 0 on the object, onwards and, in reverse, backwards. Checkpoints hold the state dict under "model".
    """

    name = "sam2"

    def __init__(self) -> None:
        self._predictor = load_predictor()

    def carry(self, pictures: Sequence[NDArray[np.uint8]], prompts: Sequence[Prompt]) -> NDArray[np.bool_]:
        """(n, h, w) the object in n RGB pictures (h, w, 3), from what is known of some frames; FreeArtError without
        `prompts`."""
        if not prompts:
            raise FreeArtError("SAM 2 needs a mask or clicks in one frame at least")
        predictor = self._predictor
        found = np.zeros((len(pictures), *pictures[0].shape[:2]), bool)
        with tempfile.TemporaryDirectory() as folder, inference():
            for i, picture in enumerate(pictures):
                _, data = cv2.imencode(".jpg", picture[..., ::-1], JPEG)
                atomic.write_bytes(Path(folder) / f"{i:05d}.jpg", data.tobytes())
            state = predictor.init_state(video_path=folder, offload_video_to_cpu=True)
            for prompt in prompts:
                if prompt.mask is not None:
                    predictor.add_new_mask(state, frame_idx=prompt.frame, obj_id=OBJECT, mask=prompt.mask)
                if prompt.clicks:
                    points = np.array([click[:2] for click in prompt.clicks], np.float32)
                    labels = np.array([click[2] for click in prompt.clicks], np.int32)
                    predictor.add_new_points_or_box(
                        state, frame_idx=prompt.frame, obj_id=OBJECT, points=points, labels=labels
                    )
            first = min(prompt.frame for prompt in prompts)
            for reverse in (True, False):
                for frame, _, logits in predictor.propagate_in_video(state, start_frame_idx=first, reverse=reverse):
                    found[frame] = logits[0, 0].float().cpu().numpy() > 0
        return found


SEGMENTERS = {"sam2": Sam2}


def make_segmenter(name: str) -> Sam2:
    """The segmenter `name`, its weights loaded; FreeArtError lists the known ones, or says what is missing."""
    if name not in SEGMENTERS:
        raise FreeArtError(f"unknown segmenter '{name}'; segmenters: {', '.join(SEGMENTERS)}")
    return SEGMENTERS[name]()
