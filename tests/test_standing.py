"""Which way an upright object faces, and what its parts are called."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command
from refusal import assert_refused
from solid_case import box
from synthetic_case import FRAMES, make_recording, make_truth
from test_export import reconstruction
from test_placement import stands

from export.exporter import export_result
from export.placement import find_standing_up
from export.settings import ExportSettings, PlacementSettings
from export.standing import find_front, name_role
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.files.asset import read_asset
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence, write_sequence
from freeart21.files.urdf import read_urdf
from freeart21.joint import Joint
from freeart21.mesh import Mesh, join_meshes
from freeart21.reconstruction import Reconstruction

Z = np.array([0.0, 0.0, 1.0])
CARCASS = box((0.4, 0.5, 0.6), (0, 0, 0.3))


def hinge(axis, pivot) -> Joint:
    return Joint("j", "revolute", np.array(axis, float), np.array(pivot, float), 0.0, 1.5)


def slide(axis) -> Joint:
    return Joint("j", "prismatic", np.array(axis, float), np.zeros(3), 0.0, 0.2)


CASES: dict[str, tuple[Joint, Mesh, Mesh, list[float], str]] = {
    "a drawer opens to the front": (
        slide((0, -1, 0)), CARCASS, box((0.36, 0.45, 0.15), (0, -0.03, 0.4)), [0, -1, 0], "drawer",
    ),
    "a lid opens at the side away from its hinge": (
        hinge((1, 0, 0), (0, 0.25, 0.6)), CARCASS, box((0.4, 0.5, 0.03), (0, 0, 0.62)), [0, -1, 0], "lid",
    ),
    "a door looks away from its carcass": (
        hinge((0, 0, 1), (0.2, -0.26, 0)), CARCASS, box((0.4, 0.02, 0.55), (0, -0.26, 0.3)), [0, -1, 0], "door",
    ),
    "an oven's door": (
        hinge((1, 0, 0), (0, -0.27, 0.05)), CARCASS, box((0.38, 0.03, 0.4), (0, -0.27, 0.27)), [0, -1, 0], "door",
    ),
    "a lever is small": (
        hinge((0, -1, 0), (0, -0.26, 0.2)), CARCASS, box((0.02, 0.02, 0.1), (0.05, -0.26, 0.2)), [1, 0, 0], "handle",
    ),
    "a slide upwards": (slide((0, 0, 1)), CARCASS, box((0.4, 0.5, 0.5), (0, 0, 0.9)), [1, 0, 0], "slider"),
    "a screen on a foot": (
        hinge((1, 0, 0), (0, 0, 0.6)), CARCASS, box((0.9, 0.04, 0.5), (0, -0.1, 0.7)), [0, -1, 0], "part",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_front_and_the_role(name: str):
    joint, standing, moving, front, role = CASES[name]
    found = find_front(Z, joint, standing, moving, 1.0)
    assert found @ Z == pytest.approx(0, abs=1e-9) and np.linalg.norm(found) == pytest.approx(1)
    assert abs(found @ front) > np.cos(np.radians(1)) and (found @ front > 0 or "upwards" in name)
    T = se3.inverse(se3.pose(np.stack([found, np.cross(Z, found), Z], -1), np.zeros(3)))
    assert name_role(joint.moved(T), standing.moved(T), moving.moved(T)) == role


def chest(frame: int) -> object:
    """A carcass that is open in front, with a drawer, in a canonical frame of the seed `frame`."""
    walls = [
        box((0.4, 0.5, 0.02), (0, 0, 0.01)), box((0.4, 0.5, 0.02), (0, 0, 0.29)),
        box((0.02, 0.5, 0.26), (0.19, 0, 0.15)), box((0.02, 0.5, 0.26), (-0.19, 0, 0.15)),
        box((0.36, 0.02, 0.26), (0, 0.24, 0.15)),
    ]  # fmt: skip
    drawer = box((0.34, 0.4, 0.2), (0, -0.02, 0.15))
    joint = Joint("slide", "prismatic", np.array([0.0, 1.0, 0.0]), np.zeros(3), -0.2, 0.0)
    parts = Articulation(joint, join_meshes(walls), drawer)
    answer = reconstruction("prismatic", (0.0, -0.1, -0.2), frame=None, **vars(parts))
    T = se3.exp_se3(np.random.default_rng(frame).normal(size=6))
    return reconstruction("prismatic", (0.0, -0.1, -0.2), **vars(answer.articulation.moved(T))), T


@pytest.mark.parametrize("frame", [1, 2])
def test_a_placed_drawer_slides_along_x_whatever_the_frame_of_the_answer(frame: int):
    answer, T = chest(frame)
    placed = stands(answer, up=tuple(T[:3, 2]))
    assert placed.roles == {"reference": "base", "moving": "drawer"}
    np.testing.assert_allclose(placed.joint.axis, [-1, 0, 0], atol=1e-6)
    assert placed.joint.lower == pytest.approx(-0.2, abs=1e-3)  # opens by negative states, towards x


def test_links_are_named_by_role_and_masses_by_either_name(tmp_path: Path, capsys):
    upright = PlacementSettings(up=(0.0, 0.0, 1.0))
    settings = ExportSettings(names="role", mass={"lid": 0.5, "reference": 2.0}, placement=upright)
    asset = export_result(reconstruction(), tmp_path / "a", settings)
    assert (asset.reference_link, asset.moving_link) == ("base", "lid")
    urdf = read_urdf(asset.urdf)
    assert urdf.links["lid"].inertial.mass == pytest.approx(0.5)
    assert urdf.links["base"].inertial.mass == pytest.approx(2.0)
    write_result(tmp_path / "ours/s1", reconstruction())
    (tmp_path / "ours/method.json").write_text('{"schema": "freeart21/method/1", "name": "ours"}')
    words = ("export", tmp_path / "ours/s1", "--out", tmp_path / "b", "--mass", "base=2", "lid=.5", "--up", 0, 0, 1)
    assert run_command(capsys, *words)[0] == 0
    assert read_asset(tmp_path / "b").moving_link == "lid"


def filmed(tilts: np.ndarray) -> tuple[Reconstruction, np.ndarray]:
    """A lid box whose reference part is tilted by `tilts` (n,), rad, and gravity (n, 3) before a camera that is held
    ever otherwise."""
    states = np.linspace(0.0, 1.1, len(tilts))
    rng = np.random.default_rng(0)
    T_camera_world = se3.exp_se3(rng.normal(size=(len(tilts), 6)))
    T_world_object = se3.pose(se3.exp_so3(tilts[:, None] * np.array([1.0, 0, 0])), np.zeros(3))
    Ts = T_camera_world @ T_world_object
    answer = reconstruction(states=tuple(states))
    moved = replace(answer, Ts_camera_reference=Ts, Ts_camera_moving=Ts @ answer.articulation.joint.transform(states))
    return moved, -T_camera_world[:, :3, 2]


def test_gravity_in_the_recording_tells_up_of_what_stood_for_most_of_the_time():
    answer, gravity = filmed(np.where(np.arange(20) < 14, 0.0, 0.1 * np.arange(20)))
    up, share = find_standing_up(answer, gravity)
    np.testing.assert_allclose(up, Z, atol=1e-6)
    assert share == pytest.approx(0.7)
    placed = stands(answer, gravity)
    np.testing.assert_allclose(placed.T_canonical_reference[:3, 2], Z, atol=1e-6)
    assert placed.report["up"]["how"] == "gravity in the recording"


def test_gravity_of_what_was_carried_about_is_not_taken_for_up():
    answer, gravity = filmed(np.linspace(-1.0, 1.0, 20))
    assert find_standing_up(answer, gravity) is None
    assert stands(answer, gravity).report["up"]["how"] != "gravity in the recording"


def test_a_sequence_keeps_gravity_and_refuses_what_is_none(tmp_path: Path):
    truth = make_truth()
    recording = replace(make_recording(truth), gravity=np.tile([0.0, 0.6, 0.8], (FRAMES, 1)))
    write_sequence(tmp_path / "s", recording, 1e-3)
    np.testing.assert_allclose(read_sequence(tmp_path / "s").gravity, recording.gravity)
    assert_refused("a unit vector a frame", replace, recording, gravity=np.zeros((FRAMES, 3)))
    write_sequence(tmp_path / "without", make_recording(truth), 1e-3)
    assert read_sequence(tmp_path / "without").gravity is None
    assert "gravity" not in (tmp_path / "without/sequence.json").read_text()
