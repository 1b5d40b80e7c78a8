"""The tracker `cotracker3`: CoTracker3 (Karaev et al. 2024), offline, by the user's own weights.

Read in facebookresearch/co-tracker at 82e02e8 (cotracker/predictor.py, hubconf.py): `CoTrackerPredictor(None,
offline=True, v2=False, window_len=60)`, whose `model` takes the state dict; called with a video (1, t, 3, h, w) from 0
to 255, which it brings to 384 x 512 itself, and queries (1, n, 3) of frame, column, row, it gives tracks (1, t, n, 2)
in the video's own pixels and whether they are visible (1, t, n).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruct.priors.weights import BroughtWeights, Checkout, inference, load_into, to_tensor
from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings
from reconstruct.trackers.windowed import WindowTracker

CHECKOUT = Checkout("co-tracker", "https://github.com/facebookresearch/co-tracker")
WEIGHTS = BroughtWeights("scaled_offline.pth", "https://huggingface.co/facebook/cotracker3 (CC-BY-NC)")
WINDOW = 60
"""The authors', of the published weights."""
MAX_POINTS = 4096
"""Followed at once, to bound memory."""


@lru_cache(1)
def load_predictor() -> Any:
    """CoTracker3 with its weights, on a GPU where there is one; FreeArtError says what is missing."""
    weights = WEIGHTS.read()
    import torch

    module = CHECKOUT.load_module("cotracker.predictor")
    predictor = module.CoTrackerPredictor(None, offline=True, v2=False, window_len=WINDOW)
    load_into(predictor.model, weights.get("model", weights), WEIGHTS.file)
    return predictor.eval().to("cuda" if torch.cuda.is_available() else "cpu")


class CoTracker3(WindowTracker):
    """Points followed through a window; dense between neighbouring frames."""

    name = "cotracker3"

    @classmethod
    def weights_digest(cls) -> str:
        """See `Tracker`."""
        return WEIGHTS.digest()

    def __init__(self, scene: Scene, settings: TrackSettings) -> None:
        super().__init__(scene, settings)
        self.predictor = load_predictor()

    def track(
        self, frames: NDArray[np.int64], at: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `WindowTracker`; the confidence is 1 where the network says visible, 0 elsewhere."""
        import torch

        device = next(self.predictor.parameters()).device
        video = 255 * torch.stack([to_tensor(self.scene.rgb[f])[0] for f in frames])[None].to(device)
        queries = torch.from_numpy(np.column_stack([np.zeros(len(at)), at])).float().to(device)
        positions, seen = [], []
        with inference():
            for some in queries.split(MAX_POINTS):
                tracks, visible = self.predictor(video, queries=some[None])
                positions.append(tracks[0].float().cpu().numpy().swapaxes(0, 1))
                seen.append(visible[0].cpu().numpy().T)
        return np.concatenate(positions).astype(float), np.concatenate(seen).astype(float)
