"""Hands in a picture, by MediaPipe's two networks (Zhang et al. 2020, "MediaPipe Hands", arXiv 2006.10214).

The files palm_detection_full.tflite and hand_landmark_full.tflite lie in the package mediapipe (not imported; it can be
installed without what it depends on: `pip install --no-deps mediapipe==0.10.21`) and, the second, in npm's
@mediapipe/hands. OpenCV runs them: offline, on a CPU.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked

PALM, LANDMARKS = "palm_detection_full.tflite", "hand_landmark_full.tflite"
_PLACES = (PALM, LANDMARKS, f"modules/palm_detection/{PALM}", f"modules/hand_landmark/{LANDMARKS}")
_PALM_SIDE, _HAND_SIDE = 192, 224
"""Pixels of the networks' inputs."""
_PALM_SCORE, _HAND_SCORE, _OVERLAP = 0.5, 0.5, 0.3
"""Least probability of a palm and of a hand, largest IoU of two palms: MediaPipe's own settings."""
_HAND_SCALE, _HAND_SHIFT = 2.6, -0.5
"""Side of a hand's square over its palm's, and how far it is moved towards the fingers, in palms: MediaPipe's."""
_FINGERS = ((1, 2, 3, 4), (5, 6, 7, 8), (9, 10, 11, 12), (13, 14, 15, 16), (17, 18, 19, 20))
_PALM_RIM = (0, 1, 2, 5, 9, 13, 17)
_FINGER_WIDTH = 0.2
"""Of a finger, over the distance from the wrist to the middle finger's root: some 18 of 90 mm (Garrett 1971)."""


@dataclass(frozen=True)
class Hand:
    """One hand."""

    points: NDArray[np.float64]
    """(21, 2) column and row, pixels: wrist, then thumb to little finger, root to tip."""
    score: float
    """0 to 1."""


def find_networks() -> Path | None:
    """The folder of the installed package mediapipe; None where it is not."""
    spec = importlib.util.find_spec("mediapipe")
    return Path(spec.origin).parent if spec is not None and spec.origin is not None else None


class HandNetwork:
    """Both networks."""

    def __init__(self, folder: Path) -> None:
        """`folder`: where the two files are, or the package mediapipe. Raises FreeArtError."""
        found = {place: Path(folder) / place for place in _PLACES if (Path(folder) / place).is_file()}
        files = [next((path for place, path in found.items() if place.endswith(n)), None) for n in (PALM, LANDMARKS)]
        for name, file in zip((PALM, LANDMARKS), files, strict=True):
            if file is None:
                raise FreeArtError(
                    f"{folder} has no {name}: pip install --no-deps mediapipe==0.10.21, or name its folder"
                )
        try:
            # the new engine of OpenCV 5 gives one output alone
            more = {"engine": cv2.dnn.ENGINE_CLASSIC} if hasattr(cv2.dnn, "ENGINE_CLASSIC") else {}
            self._palm, self._landmarks = (
                cv2.dnn.readNetFromTFLite(str(checked.require_file(file, 64 << 20, checked.ANYWHERE)), **more)
                for file in files
                if file is not None
            )
        except cv2.error as error:
            raise FreeArtError(f"{folder}: OpenCV {cv2.__version__} cannot read the networks: {error.err}") from error
        self._anchors = _make_anchors()

    def find(self, rgb: NDArray[np.uint8]) -> list[Hand]:
        """The hands in an (h, w, 3) picture, surest first."""
        hands = []
        for palm in self._find_palms(rgb):
            hand = self._find_points(rgb, palm)
            if hand is not None:
                hands.append(hand)
        return sorted(hands, key=lambda hand: -hand.score)

    def _find_palms(self, rgb: NDArray[np.uint8]) -> list[NDArray[np.float64]]:
        """Palms as (9, 2): box centre, box size, seven points (wrist, roots of fingers, thumb), pixels."""
        height, width = rgb.shape[:2]
        side = max(height, width)
        corner = np.array([(side - width) // 2, (side - height) // 2])
        square = np.zeros((side, side, 3), np.uint8)
        square[corner[1] : corner[1] + height, corner[0] : corner[0] + width] = rgb
        self._palm.setInput(cv2.dnn.blobFromImage(square, 1 / 255, (_PALM_SIDE, _PALM_SIDE)))
        boxes, scores = self._palm.forward(["Identity", "Identity_1"])
        scores = 1 / (1 + np.exp(-np.clip(scores[0, :, 0].astype(float), -100, 100)))
        kept = np.flatnonzero(scores > _PALM_SCORE)
        found = boxes[0, kept].astype(float).reshape(-1, 9, 2) / _PALM_SIDE
        found[:, np.r_[0, 2:9]] += self._anchors[kept, None]
        found *= side
        found[:, np.r_[0, 2:9]] -= corner
        rects = [(*(p[0] - p[1] / 2), *p[1]) for p in found]
        chosen = cv2.dnn.NMSBoxes(rects, scores[kept].tolist(), _PALM_SCORE, _OVERLAP) if len(kept) else ()
        return [found[i] for i in np.ravel(np.asarray(chosen, int))]

    def _find_points(self, rgb: NDArray[np.uint8], palm: NDArray[np.float64]) -> Hand | None:
        """The hand around a palm; None where the second network sees none."""
        along = palm[4] - palm[2]  # from the wrist to the middle finger's root
        up = along / max(float(np.linalg.norm(along)), 1e-9)
        side = _HAND_SCALE * float(palm[1].max())
        centre = palm[0] - _HAND_SHIFT * float(palm[1].max()) * up
        right = np.array([-up[1], up[0]])
        frame = np.stack([right, -up], 1) * side / _HAND_SIDE  # columns: a step to the right and down in the square
        to_picture = np.c_[frame, centre - frame @ np.full(2, _HAND_SIDE / 2)]
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        square = cv2.warpAffine(rgb, to_picture, (_HAND_SIDE, _HAND_SIDE), flags=flags)
        self._landmarks.setInput(cv2.dnn.blobFromImage(square, 1 / 255, (_HAND_SIDE, _HAND_SIDE)))
        points, score = self._landmarks.forward(["Identity", "Identity_1"])
        if float(score.ravel()[0]) < _HAND_SCORE:
            return None
        flat = points.reshape(21, 3)[:, :2].astype(float)
        return Hand(flat @ to_picture[:, :2].T + to_picture[:, 2], float(score.ravel()[0]))


def draw_hand(hand: Hand, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """The pixels of a picture of `shape` (rows, columns, ...) that a hand's palm and fingers cover, seen or hidden."""
    image = np.zeros(shape[:2], np.uint8)
    width = max(1, round(_FINGER_WIDTH * float(np.linalg.norm(hand.points[9] - hand.points[0]))))
    points = np.rint(np.clip(hand.points, -1e4, 1e4)).astype(np.int32)
    cv2.fillPoly(image, [points[list(_PALM_RIM)]], 1)
    cv2.polylines(image, [points[list(_PALM_RIM)]], True, 1, width)
    for finger in _FINGERS:
        cv2.polylines(image, [points[list(finger)]], False, 1, width)
    return image > 0


def _make_anchors() -> NDArray[np.float64]:
    """(2016, 2) centres of the palm network's anchors over its side: two a cell of 8 pixels, six a cell of 16."""
    found = []
    for cells, each in ((_PALM_SIDE // 8, 2), (_PALM_SIDE // 16, 6)):
        row, column = np.mgrid[:cells, :cells]
        found.append(np.repeat((np.stack([column, row], -1).reshape(-1, 2) + 0.5) / cells, each, 0))
    return np.concatenate(found)
