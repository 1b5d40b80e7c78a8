"""`reconstruct.hands`: where the networks' numbers lie in the picture, and what a hand found tells the masks."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from test_masks import F, H, W, film, iou_of

import reconstruct.masks as masks
from freeart21.errors import FreeArtError
from reconstruct.hands import LANDMARKS, PALM, Hand, HandNetwork, _make_anchors, draw_hand, find_networks
from reconstruct.masks import MaskSettings, find_masks

WRIST, UP = np.array([100.0, 160.0]), np.array([0.6, -0.8])
RIGHT = np.array([0.8, 0.6])
PALM_SIDE = 40.0


class Palm:
    """One palm at the anchor nearest to its centre, in a picture of 240 x 200."""

    centre = WRIST + 20 * UP

    def setInput(self, blob):
        assert blob.shape == (1, 3, 192, 192) and blob.max() <= 1

    def forward(self, names):
        boxes, scores = np.zeros((1, 2016, 18), np.float32), np.full((1, 2016, 1), -9, np.float32)
        corner, side = np.array([0, 20]), 240
        anchors = _make_anchors()
        at = int(np.argmin(np.linalg.norm(anchors - (self.centre + corner) / side, axis=1)))
        points = np.zeros((9, 2))
        points[[0, 2, 4]] = self.centre, WRIST, WRIST + 40 * UP
        boxes[0, at] = ((points + corner) / side - anchors[at]).ravel() * 192
        boxes[0, at, 2:4] = PALM_SIDE / side * 192
        scores[0, at] = 5
        return [{"Identity": boxes, "Identity_1": scores}[name] for name in names]


class Landmarks:
    """All points at the middle of the square but the middle finger's tip, which is right above it at the rim."""

    score = 0.9

    def setInput(self, blob):
        assert blob.shape == (1, 3, 224, 224)

    def forward(self, names):
        points = np.full((21, 3), 112.0, np.float32)
        points[12, :2] = 112, 0
        return [{"Identity": points.reshape(1, 63), "Identity_1": np.array([[self.score]])}[name] for name in names]


def network(score: float = 0.9) -> HandNetwork:
    made = HandNetwork.__new__(HandNetwork)
    made._palm, made._landmarks, made._anchors = Palm(), Landmarks(), _make_anchors()
    made._landmarks.score = score
    return made


def test_points_come_back_to_the_picture_turned_as_the_palm_is():
    (hand,) = network().find(np.zeros((200, 240, 3), np.uint8))
    centre = Palm.centre + 0.5 * PALM_SIDE * UP
    assert np.allclose(hand.points[0], centre, atol=0.01)
    assert np.allclose(hand.points[12], centre + 0.5 * 2.6 * PALM_SIDE * UP, atol=0.01)
    assert network(0.4).find(np.zeros((200, 240, 3), np.uint8)) == []


def test_a_hand_is_drawn_as_palm_and_fingers():
    points = np.tile(np.array([[50.0, 80.0]]), (21, 1))
    points[[1, 2, 5, 9, 13, 17]] = [40, 70], [35, 60], [40, 40], [50, 38], [58, 40], [64, 45]
    for k, finger in enumerate(((6, 7, 8), (10, 11, 12), (14, 15, 16), (18, 19, 20))):
        points[list(finger)] = [[38 + 9 * k, y] for y in (30, 20, 10)]
    points[[3, 4]] = [30, 52], [26, 46]
    drawn = draw_hand(Hand(points, 1.0), (100, 120, 3))
    assert drawn[60, 50] and drawn[12, 38] and not drawn[12, 26] and not drawn[60, 80]
    assert 1_000 < drawn.sum() < 3_000


def test_a_folder_without_the_networks_is_refused(tmp_path):
    with pytest.raises(FreeArtError, match=f"has no {PALM}: pip install"):
        HandNetwork(tmp_path)
    (tmp_path / PALM).write_bytes(b"junk" * 100)
    (tmp_path / LANDMARKS).write_bytes(b"junk" * 100)
    with pytest.raises(FreeArtError, match="cannot read the networks"):
        HandNetwork(tmp_path)


def test_a_hand_that_is_found_tells_an_object_of_its_colour_from_it(monkeypatch, tmp_path):
    """The block is of skin's colours: without a network it goes with the hand."""
    wood = film(paint=((200, 148, 120), (190, 140, 112)))
    drawn = np.zeros((len(wood), H, W), bool)
    for i, frame in enumerate(wood.frames()):
        drawn[i] = (frame.depth < 0.49) & ~frame.mask
        drawn[i, 80:] = False
    monkeypatch.setattr(masks, "HandNetwork", lambda folder: None)
    monkeypatch.setattr(masks, "_draw_hands", lambda video, network, progress: drawn)
    before = iou_of(find_masks(wood).masks, wood)
    after = iou_of(find_masks(wood, MaskSettings(hands=tmp_path)).masks, wood)
    assert after > before + 0.1


@pytest.mark.skipif(find_networks() is None, reason="mediapipe is not installed: pip install --no-deps mediapipe")
def test_the_real_networks_run():
    folder = find_networks()
    assert folder is not None
    grey = np.full((120, 160, 3), 127, np.uint8)
    cv2.circle(grey, (80, 60), int(F) // 4, (200, 150, 130), -1)
    assert HandNetwork(Path(folder)).find(grey) == []
