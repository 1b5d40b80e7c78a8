"""Networks that the user brings: their interfaces, by tiny networks of the same layout in folders like the clones."""

import sys

import numpy as np
import pytest
from refusal import assert_refused

from reconstruct import segmenters
from reconstruct.priors.weights import FOLDER
from reconstruct.segmenters import Prompt, make_segmenter

torch = pytest.importorskip("torch")

# The stand-in follows the colour of its input: so a wrong range, order or direction of anything is seen in what comes
# out.
SAM2 = """
import os
import cv2
import torch

class Predictor(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.image_encoder = torch.nn.Linear(2, 2)

    def init_state(self, video_path, offload_video_to_cpu=False, offload_state_to_cpu=False):
        names = sorted(os.listdir(video_path), key=lambda p: int(os.path.splitext(p)[0]))
        assert not self.training and self.image_encoder.weight.unique().numel() == 1
        return {"video": [cv2.imread(os.path.join(video_path, name))[..., ::-1] for name in names], "given": {}}

    def add_new_mask(self, inference_state, frame_idx, obj_id, mask):
        assert mask.shape == inference_state["video"][frame_idx].shape[:2] and mask.dtype == bool
        inference_state["given"][frame_idx] = inference_state["video"][frame_idx][mask].mean(0)

    def add_new_points_or_box(self, inference_state, frame_idx, obj_id, points=None, labels=None):
        assert points.shape == (len(labels), 2)
        (x, y), = points[labels == 1]
        inference_state["given"][frame_idx] = inference_state["video"][frame_idx][int(y), int(x)].astype(float)

    def propagate_in_video(self, inference_state, start_frame_idx=None, max_frame_num_to_track=None, reverse=False):
        colour = inference_state["given"][min(inference_state["given"])]
        n = len(inference_state["video"])
        for t in range(start_frame_idx, -1, -1) if reverse else range(start_frame_idx, n):
            off = torch.tensor(abs(inference_state["video"][t].astype(float) - colour).max(-1))
            yield t, [1], (30 - off)[None, None]

def build_sam2_video_predictor(config_file, ckpt_path=None, device="cuda", mode="eval"):
    assert config_file == "configs/sam2.1/sam2.1_hiera_s.yaml" and ckpt_path is None
    return Predictor()
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of weights; networks and modules loaded from it are forgotten afterwards."""
    monkeypatch.setenv(FOLDER, str(tmp_path))
    known = set(sys.modules)
    yield tmp_path
    segmenters.load_predictor.cache_clear()
    for name in set(sys.modules) - known:
        if name.split(".")[0] == "sam2":
            del sys.modules[name]


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def save(folder, name, shapes, under=None):
    weights = {key: torch.full(shape, 0.25) for key, shape in shapes.items()}
    torch.save({under: weights} if under else weights, folder / name)


def test_masks_are_carried_through_the_video_both_ways(folder):
    pictures = [np.full((40, 60, 3), (20, 60, 90), np.uint8) for _ in range(5)]
    truth = np.zeros((5, 40, 60), bool)
    for i, picture in enumerate(pictures):
        truth[i, 10:30, 5 + 6 * i : 25 + 6 * i] = True
        picture[truth[i]] = (200, 120, 40)
    assert_refused("sam2.1_hiera_tiny.pt is missing: get it from", make_segmenter, "sam2")
    save(folder, "sam2.1_hiera_small.pt", {"image_encoder.weight": (2, 2), "image_encoder.bias": (2,)}, "model")
    write(folder, "sam2/sam2/build_sam.py", SAM2)
    for prompt in (Prompt(2, truth[2]), Prompt(3, clicks=((33.0, 20.0, True), (1.0, 1.0, False)))):
        found = make_segmenter("sam2").carry(pictures, [prompt])
        assert found.shape == truth.shape and found.dtype == bool
        assert (found != truth).mean() < 0.03  # JPEG blurs the outline
    assert_refused("needs a mask or clicks", make_segmenter("sam2").carry, pictures, [])
