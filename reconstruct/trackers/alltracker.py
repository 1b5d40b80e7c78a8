"""The tracker `alltracker`: AllTracker (Harley et al., ICCV 2025), the paper's, by the user's own weights.

Read in aharley/alltracker at c1ed462 (demo.py, nets/alltracker.py): `Net(16)`, state dict under "model";
`forward_sliding(video, iters=4, sw=None, is_training=False)` of a video (1, t, 3, h, w) from 0 to 255, which it
normalises itself, gives displacements (1, t, 2, h, w) in pixels from frame 0 to each, column and row, and the
probabilities of visibility and confidence (1, t, 2, h, w); without t where the video has two frames. Sides are
multiples of 8.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruct.priors.weights import BroughtWeights, Checkout, enlarge, inference, load_into, to_tensor
from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings
from reconstruct.trackers.windowed import WindowTracker
from reconstruct.tracks import bilinear

CHECKOUT = Checkout("alltracker", "https://github.com/aharley/alltracker")
WEIGHTS = BroughtWeights("alltracker.pth", "https://huggingface.co/aharley/alltracker")
WINDOW, ITERATIONS = 16, 4
"""The authors', of the published weights."""
MULTIPLE = 8
ENLARGEMENT = 2.0
"""A crop is enlarged so many times; the authors' demo brings the longer side to 1,024 pixels. Not measured."""


@lru_cache(1)
def load_network() -> Any:
    """AllTracker with its weights, on a GPU where there is one; FreeArtError says what is missing."""
    weights = WEIGHTS.read()
    import torch

    network = CHECKOUT.load_module("nets.alltracker").Net(WINDOW)
    load_into(network, weights.get("model", weights), WEIGHTS.file)
    return network.to("cuda" if torch.cuda.is_available() else "cpu")


class AllTracker(WindowTracker):
    """Dense flow from the first frame of a window to each of its frames."""

    name = "alltracker"

    @classmethod
    def weights_digest(cls) -> str:
        """See `Tracker`."""
        return WEIGHTS.digest()

    def __init__(self, scene: Scene, settings: TrackSettings) -> None:
        super().__init__(scene, settings)
        self.network = load_network()

    def fields(self, frames: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Displacements (s + 1, h', w', 2) in crop pixels, and probabilities (s + 1, h', w', 2) of being visible and
        right, of the enlarged crop of the first frame."""
        import torch

        pictures = [enlarge(self.scene.rgb[f], ENLARGEMENT, MULTIPLE) for f in frames]
        device = next(self.network.parameters()).device
        video = 255 * torch.stack([to_tensor(p)[0] for p in pictures])[None].to(device)
        with inference():
            flow, seen, *_ = self.network.forward_sliding(video, iters=ITERATIONS, sw=None, is_training=False)
        found = [np.moveaxis(x.float().cpu().numpy().reshape(-1, *x.shape[-3:]), 1, -1) for x in (flow, seen)]
        if len(found[0]) < len(frames):  # of two frames, the second alone
            found = [np.concatenate([np.full_like(x, still), x]) for x, still in zip(found, (0, 1), strict=True)]
        h, w = self.scene.mask.shape[1:]
        return found[0] * np.array([w, h], np.float32) / np.array(pictures[0].shape[1::-1], np.float32), found[1]

    def dense_step(self, frame: int, direction: int) -> NDArray[np.floating[Any]]:
        """See `WindowTracker`: the network's own field."""
        flow, _ = self.fields(np.array([frame, frame + direction]))
        h, w = self.scene.mask.shape[1:]
        at = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).reshape(-1, 2).astype(float)
        return bilinear(flow[1], self._enlarged(at, flow.shape)).reshape(h, w, 2)

    def track(
        self, frames: NDArray[np.int64], at: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `WindowTracker`."""
        flow, seen = self.fields(frames)
        there = self._enlarged(at, flow.shape)
        positions = np.stack([at + bilinear(field, there) for field in flow], 1)
        return positions, np.stack([bilinear(field, there).prod(1) for field in seen], 1)

    def _enlarged(self, at: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Columns and rows (m, 2) of the crop in its enlarged picture."""
        ratio = np.array(shape[2:0:-1]) / np.array(self.scene.mask.shape[2:0:-1])
        return np.asarray((at + 0.5) * ratio - 0.5)
