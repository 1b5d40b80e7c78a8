"""Tracks of surface points over keyframes: SIFT matches joined, and KLT from frame to frame; OpenCV's both."""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np

from baselines.video import Video, lift
from freeart21.se3 import Array, Ints

GAPS = (1, 2, 4, 8, 16)
"""Keyframes between two that are matched."""
RATIO = 0.8
"""Lowe's (2004) ratio of the nearest to the second nearest descriptor."""
MOST_FEATURES = 1000
_SIFT = {"nfeatures": MOST_FEATURES, "contrastThreshold": 0.005, "edgeThreshold": 20}
"""More than OpenCV's default: the objects have plain surfaces."""
_CORNERS = {"maxCorners": 300, "qualityLevel": 0.001, "minDistance": 5, "blockSize": 5}
_LK: dict[str, Any] = {"winSize": (15, 15), "maxLevel": 3}
_BACK = 0.5
"""Pixels that a point tracked there and back may miss."""


def match_features(video: Video) -> Array:
    """Tracks (P, F, 3), metres in the camera, NaN where not seen, of SIFT features matched between keyframes of GAPS.

    Matches are mutual and pass Lowe's ratio. Joined matches make a track; of two features of one keyframe in it, the
    first counts.
    """
    sift = cv2.SIFT_create(**_SIFT)  # type: ignore[attr-defined]
    places, descriptors = [], []
    for k, frame in enumerate(video.frames):
        inside = cv2.erode(frame.mask.astype(np.uint8), np.ones((3, 3), np.uint8))
        keypoints, words = sift.detectAndCompute(_to_grey(frame.rgb), inside)
        # OpenCV counts pixel centres at whole numbers
        at = np.array([point.pt for point in keypoints], float).reshape(-1, 2) + 0.5
        points = video.lift(k, at)
        solid = np.isfinite(points[:, 0])
        places.append(points[solid])
        descriptors.append(np.zeros((0, 128), np.float32) if words is None else words[solid])
    starts = np.cumsum([0, *map(len, places)])
    parent = np.arange(starts[-1])

    def find_root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for gap in GAPS:
        for i in range(len(places) - gap):
            for a, b in _match(descriptors[i], descriptors[i + gap]):
                root_a, root_b = find_root(starts[i] + a), find_root(starts[i + gap] + b)
                parent[max(root_a, root_b)] = min(root_a, root_b)
    roots = np.array([find_root(node) for node in range(starts[-1])], int)
    names, track, counts = np.unique(roots, return_inverse=True, return_counts=True)
    tracks = np.full((len(names), len(places), 3), np.nan)
    for f in reversed(range(len(places))):
        own = slice(starts[f], starts[f + 1])
        tracks[track[own][::-1], f] = places[f][::-1]
    return tracks[counts >= 2]


def _to_grey(rgb: Any) -> Any:
    """A grey picture whose contrast is equalised in tiles: dark and plain surfaces show their texture."""
    return cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8)).apply(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))


def _match(a: Any, b: Any) -> Ints:
    """(M, 2) numbers of mutual matches that pass the ratio."""
    if min(len(a), len(b)) < 2:
        return np.zeros((0, 2), np.int64)
    products = a @ b.T  # SIFT descriptors have nearly one length
    squares = (a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2 * products
    two = np.partition(squares, 1, axis=1)[:, :2]
    best, back = squares.argmin(1), squares.argmin(0)
    good = (two[:, 0] < RATIO**2 * two[:, 1]) & (back[best] == np.arange(len(a)))
    return np.stack([np.flatnonzero(good), best[good]], 1)


def follow_corners(video: Video) -> Array:
    """Tracks (P, F, 3), metres in the camera, NaN where lost, of corners followed through all frames by KLT.

    Points that do not come back to within _BACK are lost, and those that leave the mask; new ones begin at keyframes.
    """
    recording, lucas_kanade = video.recording, partial(cv2.calcOpticalFlowPyrLK, **_LK)
    at, names = np.zeros((0, 2), np.float32), np.zeros(0, np.int64)
    rows: list[tuple[Ints, Array]] = []
    before, count = np.zeros((0, 0), np.uint8), 0
    number_of = {int(number): k for k, number in enumerate(video.numbers)}
    for number in range(len(recording)):
        key = number_of.get(number)
        frame = video.frames[key] if key is not None else recording.frame(number)
        grey = _to_grey(frame.rgb)
        if len(at):
            there, ok, _ = lucas_kanade(before, grey, at, None)
            home, _, _ = lucas_kanade(grey, before, there, None)
            near = (np.linalg.norm(home - at, axis=1) < _BACK) & (ok[:, 0] > 0)
            near &= np.isfinite(lift(recording.camera.K, frame, there + 0.5)[:, 0])
            at, names = there[near], names[near]
        if key is not None:
            free = cv2.erode(frame.mask.astype(np.uint8), np.ones((3, 3), np.uint8))
            for u, v in np.rint(at).astype(int):
                cv2.circle(free, (int(u), int(v)), int(_CORNERS["minDistance"]), 0, -1)
            found = cv2.goodFeaturesToTrack(grey, mask=free, **_CORNERS)  # type: ignore[call-overload]
            fresh = np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2)
            at = np.concatenate([at, fresh]).astype(np.float32)
            names = np.concatenate([names, count + np.arange(len(fresh))])
            count += len(fresh)
            rows.append((names, lift(recording.camera.K, frame, at + 0.5)))
        before = grey
    tracks = np.full((count, len(rows), 3), np.nan)
    for f, (which, points) in enumerate(rows):
        tracks[which, f] = points
    return tracks[np.isfinite(tracks[..., 0]).sum(1) >= 2]
