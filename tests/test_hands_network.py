"""`reconstruct.hands`: where the networks' numbers lie in the picture, and what a hand found tells the masks."""

import numpy as np
import pytest
from test_masks import H, W, film, iou_of

import reconstruct.masks as masks
from freeart21.errors import FreeArtError
from reconstruct.hands import LANDMARKS, PALM, HandNetwork
from reconstruct.masks import Foreground


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
    before = iou_of(Foreground(wood).masks().masks, wood)
    after = iou_of(Foreground(wood, tmp_path).masks().masks, wood)
    assert after > before + 0.1
