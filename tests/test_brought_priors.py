"""Networks that the user brings: their interfaces, by tiny networks of the same layout in folders like the clones."""

import sys

import numpy as np
import pytest
from refusal import assert_refused
from test_priors import plane

from reconstruct import segmenters
from reconstruct.priors.weights import FOLDER
from reconstruct.segmenters import Prompt, make_segmenter
from reconstruct.settings import TrackSettings
from reconstruct.trackers import alltracker, cotracker3
from reconstruct.trackers.alltracker import AllTracker
from reconstruct.trackers.cotracker3 import CoTracker3

torch = pytest.importorskip("torch")
STEP = 3

# The stand-ins know the plane's motion, by the brightness of their input: so a wrong range, order, scale or direction
# of anything is seen in what comes out.
ALLTRACKER = """
import torch

class Net(torch.nn.Module):
    def __init__(self, seqlen, dim=2):
        super().__init__()
        assert seqlen == 16
        self.fnet = torch.nn.Conv2d(3, dim, 1)

    def forward_sliding(self, images, iters=4, sw=None, is_training=False):
        B, T, C, H, W = images.shape
        assert B == 1 and C == 3 and H % 8 == 0 and W % 8 == 0 and 100 < images.max() <= 255 and iters == 4
        assert not self.training and self.fnet.weight.unique().numel() == 1  # the weights have been loaded
        flows = torch.zeros(1, T, 2, H, W)
        for t in range(T):
            flows[0, t, 0] = SPEED * t * W / WIDTH
        seen = torch.full((1, T, 2, H, W), 0.9)
        seen[0, :, 1, : H // 2] = 0.5
        return (flows[:, 1], seen[:, 1], [], []) if T == 2 else (flows, seen, None, None)
"""
COTRACKER = """
import torch

class CoTrackerPredictor(torch.nn.Module):
    def __init__(self, checkpoint="./checkpoints/scaled_offline.pth", offline=True, v2=False, window_len=60):
        super().__init__()
        assert checkpoint is None and offline and not v2 and window_len == 60
        self.model = torch.nn.Linear(2, 2)

    def forward(self, video, queries=None, segm_mask=None, grid_size=0, grid_query_frame=0, backward_tracking=False):
        B, T, C, H, W = video.shape
        assert B == 1 and C == 3 and 100 < video.max() <= 255 and queries.shape[2] == 3 and (queries[..., 0] == 0).all()
        assert not self.training and self.model.weight.unique().numel() == 1
        tracks = queries[:, None, :, 1:].repeat(1, T, 1, 1)
        tracks[..., 0] += SPEED * torch.arange(T)[None, :, None]
        visible = torch.ones(1, T, queries.shape[1], dtype=torch.bool)
        visible[0, 1:] = queries[0, :, 2] < H / 2
        return tracks, visible
"""
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
    caches = segmenters.load_predictor, alltracker.load_network, cotracker3.load_predictor
    known = set(sys.modules)
    yield tmp_path
    for cache in caches:
        cache.cache_clear()
    for name in set(sys.modules) - known:
        if name.split(".")[0] in ("nets", "cotracker", "sam2"):
            del sys.modules[name]


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def save(folder, name, shapes, under=None):
    weights = {key: torch.full(shape, 0.25) for key, shape in shapes.items()}
    torch.save({under: weights} if under else weights, folder / name)


def write_alltracker(folder, scene, speed=STEP):
    text = ALLTRACKER.replace("SPEED", str(speed)).replace("WIDTH", str(scene.mask.shape[2]))
    write(folder, "alltracker/nets/alltracker.py", text)
    save(folder, "alltracker.pth", {"fnet.weight": (2, 3, 1, 1), "fnet.bias": (2,)}, "model")


def write_cotracker(folder, scene, speed=STEP):
    write(folder, "co-tracker/cotracker/predictor.py", COTRACKER.replace("SPEED", str(speed)))
    save(folder, "scaled_offline.pth", {"weight": (2, 2), "bias": (2,)})


TRACKERS = {"alltracker": (AllTracker, write_alltracker), "cotracker3": (CoTracker3, write_cotracker)}


@pytest.mark.parametrize("name", TRACKERS)
def test_a_brought_tracker_in_crop_pixels_and_metres(name, folder):
    scene = plane(STEP, 6)
    kind, write_it = TRACKERS[name]
    write_it(folder, scene)
    tracker = kind(scene, TrackSettings(displacement_filter=False))
    field = tracker.step(1, 1)
    assert field.shape == (*scene.mask.shape[1:], 2)
    assert np.abs(field[scene.mask[1]] - (STEP, 0)).max() < 0.02
    assert not tracker.step(5, 1).any() and not tracker.step(0, -1).any()
    at = np.argwhere(scene.valid[0])[::200]
    for steps in (1, 4):
        tracks = tracker.follow(0, steps, pixels=at)
        assert tracks.frames.tolist() == list(range(steps + 1)) and np.array_equal(tracks.pixels[:, 0], at[:, ::-1])
        assert np.allclose(tracks.pixels[:, -1] - tracks.pixels[:, 0], (STEP * steps, 0), atol=0.02)
        inside = tracks.pixels[:, -1, 0] < scene.mask.shape[2] - 20
        upper = at[:, 0] < 0.45 * scene.mask.shape[1]
        lower = at[:, 0] > 0.55 * scene.mask.shape[1]
        seen, hidden = (upper, lower) if name == "cotracker3" else (lower, upper)  # .9 x .9 and .9 x .5
        assert tracks.visible[inside & seen, -1].all() and not tracks.visible[hidden, 1:].any()
        z = tracks.points[inside & seen, 0, 2]
        moved = tracks.points[inside & seen, -1] - tracks.points[inside & seen, 0]
        assert np.allclose(moved[:, 0], STEP * steps * z / scene.fx, rtol=0.02)
    assert len(tracker.follow(0, 2).pixels) == len(tracker.grid(0)) > 100
    assert tracker.follow(4, 3, direction=-1, pixels=at).frames.tolist() == [4, 3, 2, 1]
    assert tracker.follow(0, 3, pixels=at[:0]).pixels.shape == (0, 4, 2)


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
