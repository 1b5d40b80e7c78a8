"""Foreign layouts: samples typed by hand from their descriptions, and every trap that they set.

One 3D point is known in every sample: it must land on one known pixel, through K, camera axes, quaternions and depth.
"""

from __future__ import annotations

import functools
import json
import math
import os
import pickle
import random
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_json, reads_or_refuses
from refusal import assert_refused

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.files.benchmark import read_benchmark
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.formats import freeart21_official, rgbd_folder, third_party, untrusted_pickle, video2articulation
from freeart21.formats.convert import convert, find_sources, recording_layouts
from freeart21.formats.third_party import ReadOptions
from freeart21.joint import Joint
from freeart21.reconstruction import Reconstruction
from freeart21.truth import Truth
from generator import commands, partnet
from generator.rays import Caster
from generator.third_party import complete_truth
from leaderboard.protocols import PROTOCOLS
from leaderboard.protocols.strict import STRICT_2, Strict, measure
from leaderboard.score import score_results

W, H, N = 8, 6, 3
K_TEXT = "10.000000 0.000000 4.000000\n0.000000 10.000000 3.000000\n0.000000 0.000000 1.000000\n"
HALF = math.sqrt(0.5)


def png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def dot(row: int, column: int, value: float, dtype: type = np.uint8) -> np.ndarray:
    image = np.zeros((H, W), dtype)
    image[row, column] = value
    return image


def npz(path: Path, **arrays: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **arrays)


def refused(call: Callable[[], object], *words: str) -> None:
    """The call raises one clear line with these words."""
    text = assert_refused("", call)
    assert all(word in text for word in words), text


def read_all(read: third_party.ThirdPartyRecording) -> None:
    for i in range(len(read.recording)):
        read.recording.frame(i)
        if read.known is not None:
            read.known.side(i)


# --- the official release ---------------------------------------------------------------------------------------------

# The camera sits at the world's origin and looks along world x, z up (SAPIEN): right is -y, up is z, back is -x.
MODEL_MATRIX = [[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
P_OBJECT = np.array([0.1, 0.3, 0.2])
# Frame 0: turned by 90 deg about world z, P goes to (-0.3, 0.1, 0.2) + (2.3, -0.2, 0.1) = (2.0, -0.1, 0.3):
#          0.1 right, 0.3 up, 2 ahead: pixel 4 + 10 * 0.1 / 2 = 4.5, 3 - 10 * 0.3 / 2 = 1.5.
# Frame 1: no turn, P goes to (2.5, 0.375, -0.125): pixel 4 - 1.5 = 2.5, 3 + 0.5 = 3.5.
# Frame 2: turned by 90 deg about world x, P goes to (0.1, -0.2, 0.3) + (1.9, -0.5, -0.2) = (2.0, -0.7, 0.1): 7.5, 2.5.
OBJECT_POSES = [
    {"position": [2.3, -0.2, 0.1], "quaternion": [HALF, 0, 0, HALF]},
    {"position": [2.4, 0.075, -0.325], "quaternion": [1, 0, 0, 0]},
    {"position": [1.9, -0.5, -0.2], "quaternion": [HALF, HALF, 0, 0]},
]
PIXELS = [(1, 4), (3, 2), (2, 7)]  # row, column
DEPTHS = [2.0, 2.5, 2.0]


def official(folder: Path) -> Path:
    """An example as the release has it: metres in float32, but one file in mm; part masks of four digits."""
    raw = [
        dot(*PIXELS[0], 2.0, np.float32),  # type: ignore[arg-type]
        dot(*PIXELS[1], 2500, np.uint16),  # type: ignore[arg-type]
        dot(*PIXELS[2], 2000.0, np.float32),  # type: ignore[arg-type]
    ]
    for i, (row, column) in enumerate(PIXELS):
        bgr = np.full((H, W, 3), 255, np.uint8)
        bgr[row, column] = (30, 20, 250)
        png(folder / f"rgb/{i:05d}.png", bgr)
        npz(folder / f"depth/{i:05d}.npz", depth=raw[i])
        png(folder / f"masks/{i:05d}.png", dot(row, column, 255))
        side = (1, 0, 0)[i]
        png(folder / f"rendered_masks/mask_{side}/{i:04d}.png", dot(row, column, 1))
        png(folder / f"rendered_masks/mask_{1 - side}/{i:04d}.png", dot(0, 0, 0))
    (folder / "object_poses.json").write_text(json.dumps(OBJECT_POSES))
    (folder / "joint_states.json").write_text("[[0.25, 0.0], [0.5, 0.0], [1.0, 0.0]]")
    (folder / "camera_params.json").write_text(json.dumps([{"model_matrix": MODEL_MATRIX}] * N))
    (folder / "cam_K.txt").write_text(K_TEXT)
    return folder


@pytest.fixture
def example(tmp_path: Path) -> Path:
    return official(tmp_path / "examples" / "100109")


def assert_point_lands(read: third_party.ThirdPartyRecording, point: np.ndarray) -> None:
    """The known point of the object's frame: its pixel, its depth, and back from there to where it is."""
    camera = read.recording.camera
    for i, (row, column) in enumerate(PIXELS):
        seen = se3.transform(read.known.Ts_camera_object[i], point)
        assert camera.project(seen) == pytest.approx((column + 0.5, row + 0.5), abs=1e-6)
        frame = read.recording.frame(i)
        assert frame.depth[row, column] == pytest.approx(DEPTHS[i], abs=1e-6) == pytest.approx(seen[2])
        assert np.argwhere(frame.mask).tolist() == [[row, column]]
        assert camera.backproject(frame.depth)[row, column] == pytest.approx(seen, abs=1e-6)


def test_official_point_lands_on_its_pixel(example: Path) -> None:
    read = freeart21_official.read_example(example)
    assert_point_lands(read, P_OBJECT)
    for i, (row, column) in enumerate(PIXELS):
        frame = read.recording.frame(i)
        assert frame.rgb[row, column].tolist() == [250, 20, 30] and frame.depth.sum() == frame.depth[row, column]
        side = read.known.side(i)
        assert side[row, column] == (2, 1, 1)[i] and np.count_nonzero(side) == 1
    assert read.known.states.tolist() == [0.25, 0.5, 1.0]
    assert (read.recording.camera.width, read.recording.camera.height) == (W, H)


def test_parts_with_fewer_pixels_move_and_the_axis_turns_round(example: Path) -> None:
    known = freeart21_official.read_example(example).known
    joint = Joint("joint_0", "revolute", np.array([0, 0, 1.0]), np.array([0.2, 0, 0]), 0, 2)
    parts = known.parts(joint)
    assert parts.order == (0, 1) and parts.seen.tolist() == [[0, 1], [1, 0], [1, 0]]
    assert parts.part_mask(0)[PIXELS[0]] == 2
    masks = example / "rendered_masks"  # now the child side has more pixels
    for old, new in (("mask_0", "other"), ("mask_1", "mask_0"), ("other", "mask_1")):
        (masks / old).rename(masks / new)
    known = freeart21_official.read_example(example).known
    turned = known.parts(joint)
    assert turned.order == (1, 0) and turned.joint.axis.tolist() == [0, 0, -1] and turned.part_mask(0)[PIXELS[0]] == 2
    assert np.allclose(turned.Ts_camera[1], known.Ts_camera_object)
    for i, q in enumerate(known.states):
        assert np.allclose(turned.Ts_camera[0][i] @ turned.joint.transform(q), turned.Ts_camera[1][i])


@pytest.mark.parametrize(
    "text",
    [
        '[{"angle_rad": 0.25}, {"angle_rad": 0.5}, {"angle_rad": 1}]',
        '[{"qpos": 0.25}, {"value": [0.5]}, {"translation": 1.0}]',
        "[[0.0, 0.25], [0.0, 0.5], [0.0, 1.0]]",
    ],
)
def test_states_in_every_form(example: Path, text: str) -> None:
    (example / "joint_states.json").write_text(text)
    known = freeart21_official.read_example(example).known
    assert known.states.tolist() == [0.25, 0.5, 1.0]


def _link_out(path: Path) -> None:
    outside = path.parents[3] / "outside.png"
    path.rename(outside)
    path.symlink_to(outside)


def test_an_official_example_after_its_split(example: Path) -> None:
    """The split moves frame 1 to eval/ and counts the others anew, but leaves part masks of four digits alone."""
    (example / "eval" / "rgb").mkdir(parents=True)
    (example / "rgb/00001.png").rename(example / "eval/rgb/00000.png")
    for sub, end in (("rgb", "png"), ("masks", "png"), ("depth", "npz")):
        (example / f"{sub}/00001.{end}").unlink(missing_ok=True)
        (example / f"{sub}/00002.{end}").rename(example / f"{sub}/00001.{end}")
    (example / "object_poses.json").write_text(json.dumps([OBJECT_POSES[0], OBJECT_POSES[2]]))
    (example / "joint_states.json").write_text("[0.25, 1.0]")
    (example / "camera_params.json").write_text(json.dumps([{"model_matrix": MODEL_MATRIX}] * 2))
    info = {"eval_original_indices": [1], "train_original_indices": [0, 2]}
    (example / "eval/split_info.json").write_text(json.dumps(info))
    read = freeart21_official.read_example(example)
    assert read.recording.times_s.tolist() == pytest.approx([0, 2 / 30])
    assert read.known.side(1)[PIXELS[2]] == 1 and np.count_nonzero(read.known.side(1)) == 1
    info["train_original_indices"] = [0, 1, 2]
    (example / "eval/split_info.json").write_text(json.dumps(info))
    refused(lambda: freeart21_official.read_example(example), "names 3 frames", "has 2")


def test_without_poses_the_pictures_are_still_read(example: Path) -> None:
    (example / "object_poses.json").unlink()
    read = freeart21_official.read_example(example)
    assert read.known is None and "object_poses.json" in read.lacks and len(read.recording) == N


# --- Video2Articulation-S ---------------------------------------------------------------------------------------------

# The root link is at (1, 0.5, 0.5), turned by 90 deg about z: P = (0, 0.3, 0.1) is at (0.7, 0.5, 0.6) in the world.
P_ROOT = np.array([0.0, 0.3, 0.1])
# SAPIEN cameras look along their x, y left, z up. Frame 0: no turn, P is (2.0, -0.1, 0.3) ahead, left, up: 4.5, 1.5.
# Frame 1: turned by 90 deg about z, from (1.075, -2.0, 0.725): P is (2.5, 0.375, -0.125): 2.5, 3.5.
# Frame 2: turned by 90 deg about x, its left is world z: P is (2.0, -0.7, 0.1): 0.7 right, 0.1 up: 7.5, 2.5.
CAMERA_POSES = [
    [-1.3, 0.6, 0.3, 1, 0, 0, 0],
    [1.075, -2.0, 0.725, HALF, 0, 0, HALF],
    [-1.3, 0.6, 1.3, HALF, HALF, 0, 0],
]
VALUES = [0.0, 0.5, 1.0]


def turned_z(x: float, y: float, z: float, angle: float) -> np.ndarray:
    return np.array([x, y, z, math.cos(angle / 2), 0, 0, math.sin(angle / 2)])


ACTORS = {
    "actor_6": [turned_z(1, 0.5, 0.5, math.pi / 2)] * N,
    "actor_7": [turned_z(1, 0.7, 0.5, math.pi / 2 + q) for q in VALUES],  # a hinge at (0.2, 0, 0) of the root, along z
    "actor_8": [[1, 0.5, 0.5, *np.negative(turned_z(0, 0, 0, math.pi / 2)[3:]) * (-1) ** i] for i in range(N)],  # q, -q
}


def view(root: Path, joint: str = "joint_12_bg") -> Path:
    folder = root / "partnet_mobility/Microwave/7265" / joint / "view_1"
    raw = [
        np.where(dot(*PIXELS[0], 1) > 0, 2.0, 9.5).astype(np.float32),  # the room is there, too
        np.where(dot(*PIXELS[1], 1) > 0, 2500, 9500).astype(np.uint16),
        np.where(dot(*PIXELS[2], 1) > 0, 2000.0, 9500.0).astype(np.float64),
    ]
    for i, (row, column) in enumerate(PIXELS):
        png(folder / f"rgb/{i:06d}.jpg", np.full((H, W, 3), (30, 20, 250), np.uint8))
        npz(folder / f"depth/{i:06d}.npz", a=raw[i])
        segment = np.full((H, W), 3, np.uint8)  # a wall
        segment[row, column] = (8, 7, 6)[i]
        npz(folder / f"segment/{i:06d}.npz", a=segment)
    np.save(folder / "camera_pose.npy", np.array(CAMERA_POSES))
    np.save(folder / "intrinsics.npy", np.array([[10, 0, 4], [0, 10, 3], [0, 0, 1]], np.float32))
    home = folder.parent
    (home / "actor_pose.pkl").write_bytes(pickle.dumps(ACTORS))
    np.save(home / "gt_joint_value.npy", np.array(VALUES))
    np.save(home / "qpos.npy", np.array([[0.0, q] for q in VALUES]))
    (home / "joint_id_list.txt").write_text("joint_0\njoint_12\n")
    (home / "meta.json").write_text('{"joint_id": 12, "init": 0.0, "target": 1.2, "simulation_steps": 1000}')
    return folder


@pytest.fixture
def one_view(tmp_path: Path) -> Path:
    return view(tmp_path)


def test_video2articulation_point_lands_on_its_pixel(one_view: Path) -> None:
    read = video2articulation.read_view(one_view)
    assert_point_lands(read, P_ROOT)
    assert read.lacks == "" and read.notes == ()
    assert read.name == "Microwave-7265-joint_12-view_1" and read.object_id == "7265"
    assert [int(read.known.side(i)[PIXELS[i]]) for i in range(N)] == [1, 2, 1]
    rgb = read.recording.frame(0).rgb
    assert np.abs(rgb[0, 0].astype(int) - [250, 20, 30]).max() < 12
    assert read.recording.frame(1).depth[0, 0] == pytest.approx(9.5)


def test_the_joint_comes_from_the_poses(one_view: Path) -> None:
    known = video2articulation.read_view(one_view).known
    assert known.joint is not None and known.joint_name == "joint_12"
    joint = known.joint
    assert (
        joint.type == "revolute"
        and joint.axis == pytest.approx([0, 0, 1])
        and joint.pivot[:2] == pytest.approx([0.2, 0])
    )
    assert (joint.lower, joint.upper) == (0.0, 1.2) and known.held == {"joint_0": 0.0}
    parts = known.parts(joint)
    T = parts.Ts_camera[1]  # the moving part: turned about the hinge, which stays
    hinge = se3.transform(known.Ts_camera_object, np.array([[[0.2, 0, 0]]] * N))
    assert se3.transform(T, np.array([[[0.2, 0, 0]]] * N)) == pytest.approx(hinge)
    turn = np.swapaxes(known.Ts_camera_object[:, :3, :3], 1, 2) @ T[:, :3, :3]
    assert turn[2][:2, 0] == pytest.approx([math.cos(1.0), math.sin(1.0)])


def test_poses_show_a_slider(one_view: Path) -> None:
    actors = ACTORS | {"actor_7": [turned_z(1 + 0.2 * q, 0.7, 0.5, math.pi / 2) for q in VALUES]}
    (one_view.parent / "actor_pose.pkl").write_bytes(pickle.dumps(actors))
    for name in ("gt_joint_value", "qpos"):
        (one_view.parent / f"{name}.npy").unlink()
    np.save(one_view.parent / "gt_joint_value.npy", 0.2 * np.array(VALUES)[:, None])
    known = video2articulation.read_view(one_view).known
    assert known.joint.type == "prismatic" and known.joint.axis == pytest.approx([0, -1, 0], abs=1e-9)


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
@pytest.mark.parametrize("form", ["arrays", "lists", "table", "float32"])
def test_pickles_of_every_protocol(tmp_path: Path, protocol: int, form: str) -> None:
    rows = np.array(ACTORS["actor_7"])
    value: object = {
        "arrays": list(rows),
        "lists": rows.tolist(),
        "table": np.asfortranarray(rows),
        "float32": [row.astype(">f4") for row in rows],
    }[form]
    path = tmp_path / "actor_pose.pkl"
    old = pickle.dumps({"actor_7": value}, protocol)
    path.write_bytes(old.replace(b"numpy._core", b"numpy.core") if protocol == 0 else old)
    assert np.allclose(np.array(untrusted_pickle.read_pickle(path)["actor_7"], float), rows, atol=1e-6)


class Call:
    """Pickles to a call."""

    def __init__(self, function: Callable, *args: object) -> None:
        self.call = function, args

    def __reduce__(self) -> tuple:
        return self.call


def test_a_malicious_pickle_runs_nothing(one_view: Path, tmp_path: Path) -> None:
    mark, path = tmp_path / "ran", one_view.parent / "actor_pose.pkl"
    doubled: object = [0.0]
    for _ in range(60):
        doubled = [doubled, doubled]
    wide: object = [0.0] * 3000
    for _ in range(2):
        wide = [wide] * 3000
    evil = [
        ("posix.system", pickle.dumps(Call(os.system, f"touch {mark}"))),
        ("antigravity.fly", b"\x80\x02cantigravity\nfly\n."),
        ("builtins.eval", pickle.dumps(Call(eval, f"open({str(mark)!r}, 'w')"))),
        ("builtins.getattr", pickle.dumps({"actor_6": Call(getattr, np.zeros(1), "tofile")})),
        ("array of type 'O8'", pickle.dumps({"actor_6": np.array([None, {}], object)})),
        ("array of type 'V8'", pickle.dumps({"actor_6": np.zeros(2, [("a", "f8")])})),
        ("more than it could use", b"\x80\x02]r\xff\xff\xff\x7f."),
        ("more than it could use", pickle.dumps({"actor_6": wide})),
        ("lists in lists", pickle.dumps({"actor_6": doubled})),
        ("not a readable pickle", b"\x80\x04garbage"),
        ("not a readable pickle", b""),
    ]
    for words, data in evil:
        path.write_bytes(data)
        refused(lambda: video2articulation.read_view(one_view), "actor_pose.pkl is", words)
        assert not mark.exists()
    assert "antigravity" not in sys.modules


def test_a_joint_value_is_found_in_qpos_by_its_name(one_view: Path) -> None:
    (one_view.parent / "gt_joint_value.npy").unlink()
    known = video2articulation.read_view(one_view).known
    assert known.states.tolist() == VALUES
    (one_view.parent / "joint_id_list.txt").unlink()
    refused(lambda: video2articulation.read_view(one_view), "gt_joint_value.npy is missing", "joint_12")


# --- conversion -------------------------------------------------------------------------------------------------------

TOY_URDF = """<?xml version="1.0" ?>
<robot name="partnet_toy">
  <link name="base"/>
  <link name="link_0">
    <visual name="lid-1">
      <origin xyz="0 -0.2 0.3"/><geometry><mesh filename="textured_objs/lid.obj"/></geometry>
    </visual>
  </link>
  <joint name="joint_0" type="revolute">
    <origin xyz="0 0.2 -0.3"/><axis xyz="1 0 0"/><child link="link_0"/><parent link="link_1"/>
    <limit lower="0" upper="1.57"/>
  </joint>
  <link name="link_1">
    <visual name="box-2"><geometry><mesh filename="textured_objs/box.obj"/></geometry></visual>
  </link>
  <joint name="joint_1" type="fixed">
    <origin rpy="1.570796326794897 0 -1.570796326794897" xyz="0 0 0"/><child link="link_1"/><parent link="base"/>
  </joint>
</robot>
"""
CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
BOX_FACES = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
TOY_K = np.array([[60.0, 0, 40], [0, 60, 30], [0, 0, 1]])


def obj(low: tuple[float, ...], high: tuple[float, ...]) -> str:
    rows = [" ".join(str((low, high)[c][k]) for k, c in enumerate(corner)) for corner in CORNERS]
    return "".join(f"v {row}\n" for row in rows) + BOX_FACES


@pytest.fixture(scope="module")
def toy_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box and its lid, which turns up about the rear edge (mesh frame: y up)."""
    root = tmp_path_factory.mktemp("partnet")
    (root / "7777/textured_objs").mkdir(parents=True)
    (root / "7777/mobility.urdf").write_text(TOY_URDF)
    (root / "7777/meta.json").write_text('{"model_cat": "Box"}')
    (root / "7777/textured_objs/box.obj").write_text(obj((-0.4, -0.3, -0.3), (0.4, 0.2, 0.3)))
    (root / "7777/textured_objs/lid.obj").write_text(obj((-0.4, 0.2, -0.3), (0.4, 0.26, 0.3)))
    return root


TOY_STATES = np.linspace(-0.0, -1.2, 7)  # about +x of the mesh frame the lid opens backwards, towards negative angles


@pytest.fixture(scope="module")
def toy_example(toy_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy as an official example, drawn by rays: the object at 2.5 m turns about world z, its lid opens."""
    folder = tmp_path_factory.mktemp("official") / "examples" / "7777"
    loaded = partnet.load(toy_root / "7777")
    camera = Camera(TOY_K, 80, 60)
    caster = Caster((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()))
    T_world_cv = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    poses = []
    for i, q in enumerate(TOY_STATES):
        angle = 0.3 * i
        tilt = se3.exp_so3([0, 0.5, 0]) @ se3.exp_so3([0, 0, angle])
        T_world_object = se3.pose(tilt, [2.5, 0.1, 0.05])
        poses.append({"position": [2.5, 0.1, 0.05], "quaternion": se3.wxyz(T_world_object).tolist()})
        T = se3.inverse(T_world_cv) @ T_world_object
        hits = caster.look(camera, (T, T @ loaded.joint.transform(q)))
        side = hits.side.reshape(60, 80)
        depth = np.where(hits.side >= 0, hits.distance, 0).reshape(60, 80).astype(np.float32)
        bgr = np.array([[255, 255, 255], [40, 90, 200], [200, 90, 40]], np.uint8)[side + 1]
        png(folder / f"rgb/{i:05d}.png", bgr)
        npz(folder / f"depth/{i:05d}.npz", depth=depth)
        png(folder / f"masks/{i:05d}.png", (side >= 0).astype(np.uint8) * 255)
        for k in (0, 1):
            png(folder / f"rendered_masks/mask_{k}/{i:04d}.png", (side == k).astype(np.uint8) * 255)
    (folder / "object_poses.json").write_text(json.dumps(poses))
    (folder / "joint_states.json").write_text(json.dumps([[q] for q in TOY_STATES]))
    (folder / "camera_params.json").write_text(json.dumps([{"model_matrix": MODEL_MATRIX}] * len(poses)))
    np.savetxt(folder / "cam_K.txt", TOY_K, fmt="%.6f")
    return folder


def as_answer(truth: Truth) -> Reconstruction:
    masks = np.stack([truth.part_mask(i) for i in range(len(truth))])
    poses = truth.Ts_camera_reference, truth.Ts_camera_moving
    return Reconstruction(truth.articulation, truth.states, *poses, masks, truth.seen > 0)


@pytest.fixture(scope="module")
def native(toy_root: Path, toy_example: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy example converted to a native data folder, by the command line."""
    out = tmp_path_factory.mktemp("native") / "data"
    commands.convert(toy_example, out, "native", partnet_root=toy_root)
    return out


def test_an_official_example_becomes_a_data_folder_that_scores(
    native: Path, toy_example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = functools.partial(measure, constants=Strict(2, samples=2000))
    monkeypatch.setitem(PROTOCOLS, "strict-2", replace(STRICT_2, measure=few))
    assert read_benchmark(native).sequences == ("7777",)
    truth = read_truth(native / "truth/7777")
    recording = read_sequence(native / "sequences/7777")
    joint = truth.articulation.joint
    assert joint.type == "revolute" and truth.states == pytest.approx(TOY_STATES)
    caster = Caster((truth.articulation.reference, truth.articulation.moving))
    for i, frame in enumerate(recording.frames()):  # the truth's meshes, posed, are what the pictures show
        with np.load(toy_example / f"depth/{i:05d}.npz") as data:  # about 2.7 m in 16 bits: half a unit of 0.05 mm
            assert np.abs(frame.depth - data["depth"]).max() < 2.6e-5
        hits = caster.look(recording.camera, (truth.Ts_camera_reference[i], truth.Ts_camera_moving[i]))
        both = frame.mask & (hits.side >= 0).reshape(frame.mask.shape)
        assert both.sum() > 0.97 * frame.mask.sum() > 300
        assert np.median(np.abs(hits.distance.reshape(both.shape) - frame.depth)[both]) < 1e-4
        assert np.mean((hits.side.reshape(both.shape) + 1 == truth.part_mask(i))[both]) > 0.97
    write_result(tmp_path / "7777", as_answer(truth))
    write_method(tmp_path, Method("oracle"))
    (row,) = score_results(tmp_path, native, limit_s=None).rows
    assert row.status == "ok" and row.values["axis"] == pytest.approx(0, abs=1e-4)
    assert row.values["miou"] == 1 and row.values["chamfer_w"] == pytest.approx(0, abs=1e-4)


def test_round_trip_native_official_native(native: Path, toy_root: Path, tmp_path: Path) -> None:
    commands.convert(native / "sequences/7777", tmp_path / "official", "official", partnet_root=toy_root)
    assert (tmp_path / "official/data/partnet-mobility-v0/dataset/7777/mobility.urdf").read_text() == TOY_URDF
    commands.convert(tmp_path / "official", tmp_path / "again", "native")  # finds the object beside examples/
    one, two = read_sequence(native / "sequences/7777"), read_sequence(tmp_path / "again/sequences/7777")
    assert np.array_equal(one.times_s, two.times_s) and np.array_equal(one.camera.K, two.camera.K)
    assert one.licence == two.licence
    a, b = read_truth(native / "truth/7777"), read_truth(tmp_path / "again/truth/7777")
    for i in range(len(one)):
        x, y = one.frame(i), two.frame(i)
        assert np.array_equal(x.rgb, y.rgb) and np.array_equal(x.mask, y.mask)
        assert np.abs(x.depth - y.depth).max() <= 2e-7 * x.depth.max()
        assert np.array_equal(a.part_mask(i), b.part_mask(i))
    assert np.array_equal(a.states, b.states) and np.array_equal(a.seen, b.seen)
    for name in ("Ts_camera_reference", "Ts_camera_moving"):
        assert np.abs(getattr(a, name) - getattr(b, name)).max() < 1e-6
    assert np.abs(a.articulation.joint.axis - b.articulation.joint.axis).max() < 1e-9


def test_what_is_written_is_what_their_code_reads(native: Path, toy_root: Path, tmp_path: Path) -> None:
    """File by file from the description: names, keys, types, axes and order."""
    commands.convert(native, tmp_path / "out", "official", partnet_root=toy_root)
    folder, recording = tmp_path / "out/examples/7777", read_sequence(native / "sequences/7777")
    truth = read_truth(native / "truth/7777")
    n = len(recording)
    for sub in ("rgb", "masks", "vis", "rendered_masks/mask_0", "rendered_masks/mask_1"):
        assert sorted(p.name for p in (folder / sub).iterdir()) == [f"{i:05d}.png" for i in range(n)]
    with np.load(folder / "depth/00000.npz") as data:
        assert data["depth"].dtype == np.float32 and np.array_equal(data["depth"], recording.frame(0).depth)
    lines = (folder / "cam_K.txt").read_text().splitlines()
    assert [float(x) for x in lines[0].split()] == [60, 0, 40] and len(lines[1].split()) == 3
    poses, cameras, states = (
        json.loads((folder / f"{name}.json").read_text()) for name in ("object_poses", "camera_params", "joint_states")
    )
    assert len(poses) == len(cameras) == n and states == [[q] for q in truth.states]
    C0 = np.array(cameras[0]["model_matrix"]) @ np.diag([1, -1, -1, 1.0])
    w, x, y, z = poses[3]["quaternion"]
    R = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, poses[3]["position"]
    assert np.linalg.inv(C0) @ T == pytest.approx(truth.Ts_camera_reference[3], abs=1e-9)


def test_held_out_frames_are_the_official_split(native: Path, tmp_path: Path) -> None:
    commands.convert(native, tmp_path / "out", "official", hold_out=True)
    folder, recording = tmp_path / "out/examples/7777", read_sequence(native / "sequences/7777")
    info = json.loads((folder / "eval/split_info.json").read_text())
    held, train = info["eval_original_indices"], info["train_original_indices"]
    assert freeart21_official.eval_indices(300) == sorted(random.Random(0).sample(range(300), 15))
    assert held == random.Random(0).sample(range(7), 1) and sorted(held + train) == list(range(7))
    rgb = cv2.imread(str(folder / "eval/rgb/00000.png"))[..., ::-1]
    assert np.array_equal(rgb, recording.frame(held[0]).rgb)
    states = [[q] for q in read_truth(native / "truth/7777").states]
    assert json.loads((folder / "eval/joint_states.json").read_text()) == [states[held[0]]]
    again = freeart21_official.read_example(folder)
    assert len(again.recording) == 6 and np.array_equal(again.recording.times_s, recording.times_s[train])
    assert np.array_equal(again.recording.frame(5).rgb, recording.frame(train[5]).rgb)


def test_a_view_becomes_a_sequence_with_and_without_its_object(one_view: Path, toy_root: Path, tmp_path: Path) -> None:
    home = tmp_path / "partnet_mobility/Microwave/7265"
    done = list(convert(home.parent.parent, tmp_path / "data", "native"))
    assert [c.folder.name for c in done] == ["Microwave-7265-joint_12-view_1"] and not done[0].with_truth
    assert "--partnet-root" in done[0].notes[0] and not (tmp_path / "data/truth").exists()
    assert not (tmp_path / "data/benchmark.json").exists()
    frame = read_sequence(done[0].folder).frame(1)
    assert frame.depth[PIXELS[1]] == pytest.approx(2.5, abs=1e-3) and frame.depth[0, 0] == pytest.approx(9.5, abs=1e-3)
    root = tmp_path / "root"  # another object than the one that was filmed
    shutil.copytree(toy_root / "7777", root / "7265")
    read = video2articulation.read_view(one_view)
    refused(lambda: complete_truth(read, root, "joint_0"), "is not the joint of", "deg apart")


def test_a_view_with_its_object_gives_a_truth(tmp_path: Path) -> None:
    urdf = TOY_URDF.replace('origin xyz="0 0.2 -0.3"', 'origin xyz="0 0 -0.2"').replace("1 0 0", "0 1 0")
    urdf = urdf.replace("joint_0", "joint_12").replace('xyz="0 -0.2 0.3"', 'xyz="0 0 0.2"')
    assert urdf.count("joint_12") == 1
    folder = tmp_path / "root/7265"
    (folder / "textured_objs").mkdir(parents=True)
    (folder / "mobility.urdf").write_text(urdf)
    (folder / "textured_objs/box.obj").write_text(obj((-0.2, -0.2, -0.1), (0.2, 0.2, 0.2)))
    (folder / "textured_objs/lid.obj").write_text(obj((-0.2, -0.2, -0.25), (0.2, 0.2, -0.2)))
    place = view(tmp_path)
    read = video2articulation.read_view(place)
    truth = complete_truth(read, tmp_path / "root")
    assert truth.articulation.joint.axis == pytest.approx([0, 0, 1]) and truth.states.tolist() == VALUES
    assert truth.seen.tolist() == [[1, 0], [0, 1], [1, 0]] and truth.source["joint"] == "joint_12"
    np.save(place.parent / "qpos.npy", np.array([[-0.7, q] for q in VALUES]))
    held = TOY_HELD_JOINT.replace("LOW", "-0.7")
    (folder / "mobility.urdf").write_text(urdf.replace("</robot>", held + "</robot>"))
    refused(
        lambda: complete_truth(video2articulation.read_view(place), tmp_path / "root"), "joint 'joint_0' stood at -0.7"
    )


TOY_HELD_JOINT = """
  <link name="link_2"><visual name="k"><geometry><mesh filename="textured_objs/lid.obj"/></geometry></visual></link>
  <joint name="joint_0" type="revolute">
    <origin xyz="0 0 0"/><axis xyz="1 0 0"/><child link="link_2"/><parent link="link_1"/><limit lower="LOW" upper="1"/>
  </joint>
"""


def test_layouts_are_recognised(example: Path, one_view: Path, tmp_path: Path, native: Path) -> None:
    def find_names(source: Path) -> list[tuple[str, Path]]:
        return [(layout.name, folder) for layout, folder in find_sources(source)]

    assert find_names(example) == find_names(example.parent) == [("official", example)]
    assert find_names(one_view) == find_names(one_view.parent) == [("video2articulation", one_view)]
    assert find_names(native) == [("native", native / "sequences/7777")]
    known = ", ".join(recording_layouts())
    refused(lambda: find_sources(example, "scans"), f"unknown layout 'scans'; layouts: {known}")
    refused(lambda: find_sources(example, "native"), "holds no recording of the layout native")
    (tmp_path / "empty").mkdir()
    refused(lambda: find_sources(tmp_path / "empty"), f"a known layout: {known}", "--from LAYOUT")
    refused(lambda: find_sources(tmp_path / "empty", "video2articulation"), "camera_pose.npy")
    refused(lambda: list(convert(native, tmp_path / "x", "native")), "of the layout native already")


def test_a_failed_conversion_leaves_nothing(example: Path, tmp_path: Path, native: Path) -> None:
    npz(example / "depth/00002.npz", depth=np.zeros((H, 3), np.float32))
    refused(lambda: list(convert(example, tmp_path / "data", "native")), "frame 2: depth is 3 x 6")
    assert not (tmp_path / "data").exists()
    data = Path(shutil.copytree(native, tmp_path / "broken"))
    (data / "sequences/7777/rgb/00004.png").write_bytes(b"no picture")
    refused(lambda: list(convert(data, tmp_path / "out", "official")), "00004.png is not a readable image")
    assert not (tmp_path / "out").exists()
    steps: list[tuple[str, int, int]] = []
    list(convert(native, tmp_path / "twice", "official", progress=lambda *now: steps.append(now)))
    assert steps == [("7777", i + 1, 7) for i in range(7)]
    refused(lambda: list(convert(native, tmp_path / "twice", "official")), "exists")


def test_truth_is_written_with_its_sequence_or_not_at_all(
    example: Path, toy_example: Path, toy_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    commands.convert(toy_example, tmp_path / "data", "native", partnet_root=tmp_path)
    output = capsys.readouterr()
    assert "without truth: PartNet-Mobility object 7777 is not in" in output.err and "sequences/7777" in output.out
    assert not (tmp_path / "data/truth").exists()


# ---- plain folders of a depth camera's pictures ----------------------------------------------------------------------

OPEN3D = {"width": W, "height": H, "intrinsic_matrix": [10.0, 0.0, 0.0, 0.0, 11.0, 0.0, 3.5, 2.5, 1.0]}
NAMES = ("frame_9", "frame_10", "frame_100")  # in time, though not by letters


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Three frames as a depth camera writes them: 0.5 m, 0.6 m, 0.7 m at the one pixel that the object covers."""
    folder = tmp_path / "my stapler"
    for i, name in enumerate(NAMES):
        png(folder / f"rgb/{name}.png", np.full((H, W, 3), 40 * i, np.uint8))
        png(folder / f"depth/{name}.png", dot(2, 5, 500 + 100 * i, np.uint16))
        png(folder / f"masks/{name}.png", dot(2, 5, 255))
    (folder / "cam_K.txt").write_text("10 0 3.5\n0 11 2.5\n0 0 1\n")
    return folder


def in_open3d(folder: Path) -> None:
    (folder / "cam_K.txt").unlink()
    (folder / "rgb").rename(folder / "color")
    (folder / "camera_intrinsic.json").write_text(json.dumps(OPEN3D))


@pytest.mark.parametrize("layout", ["bundlesdf", "open3d"])
def test_a_cameras_pictures_become_a_sequence(pictures: Path, tmp_path: Path, layout: str) -> None:
    if layout == "open3d":
        in_open3d(pictures)
    commands.convert(pictures, tmp_path / "data", "native", fps=10)
    recording = read_sequence(tmp_path / "data/sequences/my-stapler")
    assert not (tmp_path / "data/truth").exists()
    assert recording.times_s == pytest.approx([0, 0.1, 0.2])
    assert np.array_equal(recording.camera.K, [[10, 0, 4], [0, 11, 3], [0, 0, 1]]), "pixel centres at +0.5"
    for i, frame in enumerate(recording.frames()):
        assert frame.depth[2, 5] == pytest.approx(0.5 + 0.1 * i, abs=1e-5)
        assert frame.mask[2, 5] and frame.mask.sum() == 1 and (frame.rgb == 40 * i).all()


def test_depth_has_the_unit_that_is_given(pictures: Path) -> None:
    read = rgbd_folder.read_rgbd_folder(pictures, ReadOptions(depth_unit=1 / 5000))
    assert read.recording.frame(0).depth[2, 5] == pytest.approx(0.1)
    refused(lambda: rgbd_folder.read_rgbd_folder(pictures, ReadOptions(depth_unit=1000)), "depth unit is 1000")
    refused(lambda: rgbd_folder.read_rgbd_folder(pictures, ReadOptions(fps=0)), "fps is 0")


# --- nearly valid files -----------------------------------------------------------------------------------------------


@settings(MUTATED, max_examples=60)
@given(data=st.data())
def test_an_official_example_with_a_wrong_field_is_read_or_one_line(tmp_path: Path, data: st.DataObject) -> None:
    folder = official(tmp_path / "examples/1")
    path = folder / data.draw(st.sampled_from(("object_poses.json", "joint_states.json", "camera_params.json")))
    path.write_text(json.dumps(data.draw(mutated_json(json.loads(path.read_text())))))
    reads_or_refuses(lambda: read_all(freeart21_official.read_example(folder)))


OFFICIAL_FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing frame": (lambda f: (f / "rgb/00001.png").rename(f / "rgb/00003.png"), "frame 1 is missing"),
    "wrong size": (lambda f: png(f / "masks/00001.png", np.zeros((H, W + 1), np.uint8)), "frame 1: mask is 9 x 6"),
    "metres in whole numbers": (lambda f: npz(f / "depth/00001.npz", depth=dot(3, 2, 2, np.uint16)), "millimetres"),
    "K text": (lambda f: (f / "cam_K.txt").write_text("one two three\n"), "3 x 3"),
    "link out": (lambda f: _link_out(f / "rgb/00001.png"), "leads out of the folder"),
}


@pytest.mark.parametrize("fault", OFFICIAL_FAULTS)
def test_a_broken_official_example_is_one_clear_line(example: Path, fault: str) -> None:
    change, words = OFFICIAL_FAULTS[fault]
    change(example)
    refused(lambda: read_all(freeart21_official.read_example(example)), words)


VIEW_FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing pickle": (lambda f: (f.parent / "actor_pose.pkl").unlink(), "actor_pose.pkl is missing"),
    "camera count": (lambda f: np.save(f / "camera_pose.npy", np.array(CAMERA_POSES[:2])), "2 poses"),
    "segment size": (lambda f: npz(f / "segment/000001.npz", a=np.zeros((H, 5), np.uint8)), "(6, 5)"),
}


@pytest.mark.parametrize("fault", VIEW_FAULTS)
def test_a_broken_view_is_one_clear_line(one_view: Path, fault: str) -> None:
    change, words = VIEW_FAULTS[fault]
    change(one_view)
    refused(lambda: read_all(video2articulation.read_view(one_view)), words)


PICTURE_FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "no masks": (lambda f: shutil.rmtree(f / "masks"), "has no masks: `--to rgbd` writes its pictures"),
    "a frame without depth": (
        lambda f: (f / "depth/frame_10.png").unlink(),
        "is among the colours, but not",
    ),
    "shallow depth": (lambda f: png(f / "depth/frame_9.png", np.zeros((H, W), np.uint8)), "one channel of uint16"),
}


@pytest.mark.parametrize("fault", PICTURE_FAULTS)
def test_broken_pictures_are_one_clear_line(pictures: Path, tmp_path: Path, fault: str) -> None:
    spoil, words = PICTURE_FAULTS[fault]
    spoil(pictures)
    refused(lambda: list(convert(pictures, tmp_path / "data", "native")), words)
    assert not (tmp_path / "data").exists()
