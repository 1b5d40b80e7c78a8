"""The joint by printed tags: simulated corners, whose joint is known, and a film of a real renderer."""

import json

import numpy as np
import pytest
from command_line import run_command
from tagged_box import SIDE as PRINTED
from tagged_box import write_tagged_box

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import Joint
from leaderboard import markers

CAMERA = Camera(np.array([[600.0, 0, 320], [0, 600, 180], [0, 0, 1]]), 640, 360)
SIDE = 0.03
SQUARE = SIDE / 2 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])


def film(joint, noise=0.1, n=40, seed=0, loose=0.0):
    """(corners, states, poses) of a base with tags 0 to 2 and a moving part with 25 to 27, all facing the camera."""
    draw = np.random.default_rng(seed)
    front = se3.pose(np.diag([1.0, -1, -1]), [0, 0, 0.5])
    tags = {k: se3.pose(np.eye(3), [0.05 * k - 0.05, -0.05, 0]) for k in range(3)}
    tags |= {25 + k: se3.pose(np.eye(3), [0.05 * k - 0.05, 0.05, 0]) for k in range(3)}
    span = 1.0 if joint.type == "revolute" else 0.08
    states = span * (0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, n)))
    frames, ids, pixels, poses = [], [], [], []
    for i in range(n):
        base = front @ se3.exp_se3(np.array([0.02, 0.02, 0.02, 0.3, 0.3, 0.2]) * np.sin(i / 5 + np.arange(6)))
        poses.append(base)
        for tag, place in tags.items():
            T = base
            if tag >= 25:
                T = base @ joint.transform(states[i]) @ se3.exp_se3(loose * draw.normal(size=6))
            frames.append(i)
            ids.append(tag)
            pixels.append(CAMERA.project(se3.transform(T @ place, SQUARE)) + noise * draw.normal(size=(4, 2)))
    return markers.Corners(np.array(frames), np.array(ids), np.array(pixels)), states, np.array(poses)


def hinge():
    axis = np.array([1.0, 0.2, -0.1])
    return Joint("lid", "revolute", axis / np.linalg.norm(axis), np.array([0, 0.02, 0.01]), -np.inf, np.inf)


def slide():
    return Joint("drawer", "prismatic", np.array([0.0, 0.6, 0.8]), np.zeros(3), -np.inf, np.inf)


@pytest.mark.parametrize("joint", [hinge(), slide()], ids=["hinge", "slide"])
def test_joint_and_its_deviations(joint):
    found = []
    for seed in range(2):
        corners, states, poses = film(joint, n=25, seed=seed)
        got = markers.measure_joint(corners, CAMERA, SIDE, (0, 1, 2), (25, 26, 27))
        assert got.joint.type == joint.type and got.explains
        axes = got.Ts_camera_base[:, :3, :3] @ got.joint.axis
        truth = poses[:, :3, :3] @ joint.axis
        angle = np.median(np.linalg.norm(np.cross(axes, truth), axis=1))
        sign = np.sign((axes * truth).sum(1)[0])
        off = sign * got.states - states
        found.append([angle / got.axis_std, np.std(off) / np.median(got.state_std)])
        assert angle < np.radians(0.5)
    # two tilts: their norm is sqrt(2) deviations on average
    assert 0.2 < np.mean(found, axis=0)[0] < 3 and 0.5 < np.mean(found, axis=0)[1] < 1.5


def test_loose_parts_are_no_joint():
    corners, _, _ = film(hinge(), n=25, loose=0.01)
    assert not markers.measure_joint(corners, CAMERA, SIDE, (0, 1, 2), (25, 26, 27)).explains


def test_a_tag_read_wrong_changes_little():
    corners, _, poses = film(hinge(), n=25)
    wrong = corners.pixels.copy()
    wrong[::25] += 30
    got = markers.measure_joint(
        markers.Corners(corners.frames, corners.ids, wrong), CAMERA, SIDE, (0, 1, 2), (25, 26, 27)
    )
    axes, truth = got.Ts_camera_base[:, :3, :3] @ got.joint.axis, poses[:, :3, :3] @ hinge().axis
    assert np.degrees(np.median(np.linalg.norm(np.cross(axes, truth), axis=1))) < 0.5


def test_what_cannot_be_measured_is_one_line():
    corners, _, _ = film(hinge())
    with pytest.raises(FreeArtError, match="0 frames show a tag of both parts.*of the moving part: none"):
        markers.measure_joint(corners, CAMERA, SIDE, (0, 1, 2), (30,))
    with pytest.raises(FreeArtError, match="tag 1 is named as"):
        markers.measure_joint(corners, CAMERA, SIDE, (0, 1), (1, 25))
    still = corners.chosen(corners.frames < 3)
    same = markers.Corners(still.frames, still.ids, np.tile(still.pixels[:6], (3, 1, 1)))
    with pytest.raises(FreeArtError, match="too little"):
        markers.measure_joint(same, CAMERA, SIDE, (0, 1, 2), (25, 26, 27))


def test_sheet_has_the_size_that_it_says(tmp_path):
    assert markers.print_tags(tmp_path / "tags.pdf", 0.03) >= 1
    data = (tmp_path / "tags.pdf").read_bytes()
    assert data.startswith(b"%PDF") and b"/MediaBox [ 0 0 595.2 841.92 ]" in data
    with pytest.raises(FreeArtError, match="does not fit"):
        markers.print_tags(tmp_path / "large.pdf", 0.4)


def test_a_filmed_box(tmp_path, capfd):
    """Recorded by SAPIEN: the joint from the tags is the simulator's, and the command writes it."""
    urdf = write_tagged_box(tmp_path)
    size = ("--width", "960", "--height", "540", "--shader", "trivial", "--queries", "1")
    assert (
        run_command(capfd, "record", urdf, "--joint", "hinge", "--frames", "30", *size, "--out", tmp_path / "data")[0]
        == 0
    )
    (sequence,) = (tmp_path / "data" / "sequences").iterdir()
    out = tmp_path / "joint.json"
    command = ("truth-by-markers", sequence, "--side-mm", 1000 * PRINTED, "--out", out)
    code, text, _ = run_command(capfd, *command)
    assert code == 0 and text.startswith("revolute, moved by")
    recording, truth = read_sequence(sequence), read_truth(tmp_path / "data" / "truth" / sequence.name)
    half = markers.TAGS // 2
    found = markers.measure_joint(
        markers.find_corners(recording), recording.camera, PRINTED, range(half), range(half, 2 * half)
    )
    off = markers.compare(found, truth)
    assert off.same_type and off.axis_deg < 0.5 and off.pivot_m < 0.004 and off.state < np.radians(1)
    written = json.loads(out.read_text())
    assert np.allclose(written["joint"]["axis"], found.joint.axis) and len(written["states"]) == len(found.frames)
    assert run_command(capfd, *command)[0] == 1
