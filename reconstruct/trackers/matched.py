"""The trackers `lightglue` and `xfeat`: chained optical flow that starts from a matcher's matches.

For motion that is too fast for flow alone.
"""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from scipy.spatial import cKDTree

from freeart21.se3 import Floats
from reconstruct.matchers import Matcher, Matches
from reconstruct.scene import Scene
from reconstruct.settings import TrackSettings
from reconstruct.trackers.dis import FlowTracker
from reconstruct.tracks import bilinear, crop_shift, optical_flow

NEIGHBOURS = 5
"""Nearest matches whose median displacement a pixel takes: two of them may be wrong."""
WINDOW = 5
"""Pixels, each way, over which two flows are compared."""


class MatchedFlow(FlowTracker):
    """DIS flow twice, from nothing and from matches; a pixel takes the one whose way there and back ends nearer."""

    matcher: ClassVar[str]
    """One of `reconstruct.matchers`."""

    def __init__(self, scene: Scene, settings: TrackSettings) -> None:
        super().__init__(scene, settings)
        points, flow = Matcher(self.matcher, scene), optical_flow(scene)
        for i in range(len(scene) - 1):
            pair = flow.step(i, 1), flow.step(i + 1, -1)
            flow.forward[i], flow.backward[i + 1] = improve_flow(scene, i, i + 1, pair, points.match(i, i + 1))
        self.flow = flow


class LightGlue(MatchedFlow):
    """From LightGlue's matches (extra `priors`)."""

    name = matcher = "lightglue"


class Xfeat(MatchedFlow):
    """From XFeat's matches (extra `priors`)."""

    name = matcher = "xfeat"


def improve_flow(
    scene: Scene, first: int, second: int, pair: tuple[Floats, Floats], matches: Matches
) -> tuple[Floats, Floats]:
    """Flow (h, w, 2) there and back: `pair`, or where it returns nearer, flow that starts from `matches`."""
    if len(matches) < NEIGHBOURS:
        return pair
    there = matched_flow(scene, first, second, matches)
    back = matched_flow(scene, second, first, Matches(matches.there, matches.here, matches.confidence))
    better = round_trip(there, back) < round_trip(*pair), round_trip(back, there) < round_trip(*pair[::-1])
    return np.where(better[0][..., None], there, pair[0]), np.where(better[1][..., None], back, pair[1])


def matched_flow(scene: Scene, first: int, second: int, matches: Matches) -> Floats:
    """DIS flow (h, w, 2) between any two frames, started from the displacements of the nearest matches."""
    grey = [
        np.where(m, 40 + 0.84 * cv2.cvtColor(c, cv2.COLOR_RGB2GRAY), 0).astype(np.uint8)
        for c, m in ((scene.rgb[k], scene.mask[k]) for k in (first, second))
    ]
    initial = np.tile(crop_shift(scene, first, second).astype(np.float32), (*scene.mask.shape[1:], 1))
    at = np.argwhere(scene.mask[first])
    if len(at) and len(matches) >= NEIGHBOURS:
        _, near = cKDTree(matches.here).query(at[:, ::-1], k=NEIGHBOURS)
        initial[tuple(at.T)] = np.median((matches.there - matches.here)[near], axis=1)
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return np.asarray(dis.calc(grey[0], grey[1], initial), np.float32)


def round_trip(there: Floats, back: Floats) -> Floats:
    """(h, w) mean distance, pixels, between a pixel and where the way there and back ends, in a window round it."""
    h, w = there.shape[:2]
    at = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).reshape(-1, 2) + there.reshape(-1, 2).astype(float)
    gap = np.linalg.norm(there.reshape(-1, 2) + bilinear(back, at), axis=1).reshape(h, w)
    return np.asarray(cv2.blur(gap, (WINDOW, WINDOW)), np.float32)
