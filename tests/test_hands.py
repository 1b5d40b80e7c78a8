"""What stands before the object, measured in depth but not in the mask, hides it; what stands behind does not."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from reconstruct_clip import make_clip
from test_reconstruct import GENTLE, QUIET, measure
from test_surfaces import CAMERA, ROUND, shoot

from freeart21 import se3
from freeart21.recording import Frame, Recording
from reconstruct.evidence import Evidence
from reconstruct.kernels import HIDDEN
from reconstruct.pipeline import reconstruct
from reconstruct.scene import prepare_scene
from reconstruct.settings import SceneSettings, SurfaceSettings
from reconstruct.surfaces import fuse


def hold(frame, before, known_depth=True):
    """`frame` with a hand in the pixels `before` (h, w), 2 cm nearer than the object; with or without a known depth."""
    depth = np.where(before, frame.depth[frame.mask].min() - 0.02 if known_depth else 0, frame.depth).astype(np.float32)
    return Frame(np.where(before[..., None], np.uint8(190), frame.rgb), depth, frame.mask & ~before)


def filmed(frames, recording):
    return replace(recording, load=lambda i: frames[i])


def lower_right(frame, share=0.45):
    """(h, w) the corner of the picture that holds about this share of the object, both ways."""
    rows, columns = np.nonzero(frame.mask)
    corner = np.quantile(rows, 1 - share), np.quantile(columns, 1 - share)
    y, x = np.indices(frame.mask.shape)
    return (y > corner[0]) & (x > corner[1])


@pytest.fixture(scope="module")
def clip():
    return make_clip("hinge", 24, size=(160, 120), spin=GENTLE)


def evidence_of(clip, frames):
    return Evidence(prepare_scene(filmed(frames, clip.recording), SceneSettings()), QUIET.evidence, QUIET.labels)


def over_the_hand(clip, known_depth):
    """Evidence, the reference part's pixels of frame 0, and its motion to frame 1, in which a hand is before it."""
    frames = list(clip.recording.frames())
    frames[1] = hold(frames[1], lower_right(frames[1]), known_depth)
    evidence = evidence_of(clip, frames)
    x, y = evidence.scene.origin[0]
    h, w = evidence.scene.mask.shape[1:]
    mine = evidence.scene.valid[0] & (clip.part_masks[0][y : y + h, x : x + w] == 1)
    return evidence, np.argwhere(mine), clip.Ts[1] @ se3.inverse(clip.Ts[0])


def test_a_pixel_behind_a_hand_says_nothing_against_a_motion(clip):
    evidence, pixels, T = over_the_hand(clip, known_depth=True)
    blind, _, _ = over_the_hand(clip, known_depth=False)
    costs, untold = (e.costs(0, np.array([1]), T[None, None], pixels)[:, 0, 0] for e in (evidence, blind))
    covered = untold > 2 * HIDDEN
    assert covered.mean() > 0.1, "else the hand covers nothing"
    assert (costs[covered] <= HIDDEN + 1e-9).mean() > 0.98
    assert np.allclose(costs[~covered], untold[~covered], atol=HIDDEN)


@pytest.mark.parametrize("known_depth", [True, False])
def test_a_hand_carves_nothing_off_a_mesh(known_depth):
    size = np.array([0.12, 0.09, 0.06])
    frames = [hold(f, lower_right(f, 0.3), known_depth) for f in (shoot(size, T) for T in ROUND)]
    scene = prepare_scene(Recording(CAMERA, np.arange(len(ROUND)) / 30, lambda i: frames[i]), SceneSettings())
    mesh = fuse(scene, scene.mask.astype(np.uint8), 1, ROUND, np.ones(len(ROUND), bool), SurfaceSettings())
    off = np.abs(trimesh.proximity.signed_distance(trimesh.creation.box(size), mesh.vertices))
    off = np.percentile(off, 99) / scene.footprint
    assert off < 0.5 if known_depth else off > 1.5, off
    assert not known_depth or mesh.areas().sum() > 0.94 * trimesh.creation.box(size).area


def test_a_clip_in_a_moving_hand_is_solved(clip):
    """The hand goes once round the object's middle, over one part and the other."""
    frames = [hold(f, round_hand(f, 2 * np.pi * i / 24)) for i, f in enumerate(clip.recording.frames())]
    masks = np.stack([np.where(f.mask, m, 0) for f, m in zip(frames, clip.part_masks, strict=True)])
    recording = filmed(frames, clip.recording)
    found = measure(replace(clip, part_masks=masks), reconstruct(recording, QUIET))
    assert found["axis"] < 2.5 and found["line"] < 0.5 and found["state"] < 0.3 and found["miou"] > 0.96, found


def round_hand(frame, angle):
    """(h, w) a disc over part of the object, off its middle in the direction `angle`."""
    y, x = np.indices(frame.mask.shape)
    rows, columns = np.nonzero(frame.mask)
    size = np.ptp(columns)
    off = y - rows.mean() - 0.4 * np.ptp(rows) * np.sin(angle), x - columns.mean() - 0.4 * size * np.cos(angle)
    return np.hypot(*off) < 0.2 * size
