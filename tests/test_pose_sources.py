"""Poses of the parts that another program found: read from its files, and used as initial guesses."""

from dataclasses import replace

import numpy as np
import pytest
from reconstruct_clip import make_clip
from refusal import assert_refused
from test_reconstruct import QUIET, true_estimate
from test_recovery import SIZE, partial_propagation, without

from freeart21 import se3
from reconstruct.pose_sources import find_poses
from reconstruct.segmentation import add_frames
from reconstruct.trackers.dis import Dis

FRAMES, HIDDEN = 22, slice(10, 18)
NOISE_M, NOISE_RAD = 0.002, 0.01


@pytest.fixture(scope="module")
def hidden():
    """A hinge that turns far while it is hidden."""
    clip = without(make_clip("hinge", FRAMES, size=SIZE, spin=0.8), HIDDEN)
    evidence, true = true_estimate(clip, HIDDEN, slice(None))
    return clip, evidence, replace(true, logodds=4 * true.logodds)


def write_run(folder, clip, moving=False, change=lambda T: T):
    """Poses of one part as BundleSDF writes them, with noise, in a frame of its own at the middle of its points."""
    rng, place = np.random.default_rng(3), folder / "ob_in_cam"
    place.mkdir(parents=True)
    Ts = clip.Ts @ clip.joint.transform(clip.states) if moving else clip.Ts
    frame = clip.recording.load(0)
    depth, mask = frame.depth, frame.mask
    row, column = np.nonzero(mask & (depth > 0))
    camera = clip.recording.camera
    z = depth[row, column]
    middle = np.array(
        [
            np.mean((column - camera.K[0, 2]) / camera.K[0, 0] * z),
            np.mean((row - camera.K[1, 2]) / camera.K[1, 1] * z),
            z.mean(),
        ]
    )
    body = se3.inverse(Ts[0]) @ se3.exp_se3(np.array([*middle, 0.0, 0.0, 0.0]))
    for i, T in enumerate(Ts):
        noise = se3.exp_se3(np.concatenate([rng.normal(0, NOISE_M, 3), rng.normal(0, NOISE_RAD, 3)]))
        np.savetxt(place / f"{i:05d}.txt", change(T @ body @ noise), fmt="%.10g")
    return f"bundlesdf:{folder}"


@pytest.mark.parametrize("moving", [False, True])
def test_an_object_that_was_hidden_is_found_again_by_given_poses(hidden, tmp_path, moving):
    """By those of either part: nobody says which part they are of."""
    clip, evidence, true = hidden
    last, turn = HIDDEN.stop, {}
    for given in ("", write_run(tmp_path, clip, moving)):
        evidence.given_poses = find_poses(evidence.scene, given)
        known = clip, evidence, true, Dis(evidence.scene, QUIET.tracks)
        propagation = partial_propagation(HIDDEN.start, known, QUIET)
        add_frames(propagation, last + 1 - HIDDEN.start)
        R = propagation.Ts[0, last, :3, :3].T @ clip.Ts[last, :3, :3]
        turn[bool(given)] = np.degrees(np.linalg.norm(se3.log_so3(R)))
    evidence.given_poses = find_poses(evidence.scene, "")
    assert turn[True] < 5 < 40 < turn[False], turn


def test_poses_are_checked(hidden, tmp_path):
    clip, evidence, _ = hidden
    scene = evidence.scene

    def in_millimetres(T):
        return np.vstack([np.hstack([T[:3, :3], 1000 * T[:3, 3:]]), T[3:]])

    for name, change, match in (
        ("mm", in_millimetres, "expected metres"),
        ("inverse", se3.inverse, "map points of the object to the camera"),
        ("scaled", lambda T: T @ np.diag([2.0, 2, 2, 1]), "not a rigid pose"),
    ):
        assert_refused(match, find_poses, scene, write_run(tmp_path / name, clip, change=change))
    given = write_run(tmp_path / "good", clip)
    poses = find_poses(scene, given)
    assert poses.shape == (1, FRAMES, 4, 4) and np.isfinite(poses).all()
    place = tmp_path / "good" / "ob_in_cam"
    for wrong in ("1 2 3", "nan " * 16, "x " * 16):
        (place / "00004.txt").write_text(wrong)
        assert_refused("00004.txt", find_poses, scene, given)
    (place / "00004.txt").unlink()
    assert np.isnan(find_poses(scene, given)[0, 4]).all()
    (place / "00000.txt").rename(place / "00022.txt")
    assert_refused("00022.txt is of no frame of the video, expected numbers from 0 to 21", find_poses, scene, given)
    for path in place.iterdir():
        path.unlink()
    assert_refused("has 0 poses", find_poses, scene, given)
    assert_refused("unknown source of poses 'x'; sources: bundlesdf", find_poses, scene, "x")
    for folder in ("", str(tmp_path / "none"), str(tmp_path)):
        assert_refused("runs of BundleSDF, expected 1 or 2", find_poses, scene, f"bundlesdf:{folder}")
