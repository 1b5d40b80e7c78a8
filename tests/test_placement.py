"""Where an asset stands, where its joint is at zero and ends, and how deep its parts are in each other."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from refusal import assert_refused
from solid_case import box

from export.carving import carve_overlap, make_solid
from export.exporter import export_result
from export.joint_range import estimate_joint_range, robust_maximum
from export.parts import carve_parts
from export.penetration import Overlap
from export.placement import Placement, place_parts
from export.resting_pose import resting_poses
from export.settings import TOLERANCE, ExportSettings, PlacementSettings
from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction


def lidded(opened: float = 0.0, gap: float = 0.0) -> Articulation:
    """A solid 0.2 x 0.15 x 0.1 m, z up, and a lid hinged at its edge x = -0.1, which opens by positive states.

    At state zero the lid is open by `opened`, rad; closed it is `gap`, metres, above the solid.
    """
    hinge = Joint("hinge", "revolute", np.array([0.0, -1.0, 0.0]), np.array([-0.1, 0.0, 0.05]), -np.inf, np.inf)
    lid = box((0.2, 0.15, 0.01), (0.0, 0.0, 0.055 + gap)).moved(hinge.transform(opened))
    return Articulation(hinge, box((0.2, 0.15, 0.1)), lid)


def seen_as(
    parts: Articulation, states, std=None, tilt: float = 0.4, seen=None, Ts_camera_reference=None
) -> Reconstruction:
    """The object before a camera that looks down on it by `tilt`, rad; given in that camera's frame."""
    down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # camera (right, down, forward) from the object, level
    c, s = np.cos(tilt), np.sin(tilt)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ down
    parts = parts.moved(se3.pose(R, np.array([0.02, -0.03, 0.7])))
    states = np.array(states, float)
    n = len(states)
    still = np.tile(np.eye(4), (n, 1, 1)) if Ts_camera_reference is None else Ts_camera_reference
    return Reconstruction(
        replace(parts, joint=replace(parts.joint, lower=states.min(), upper=states.max())),
        states,
        still,
        still @ parts.joint.transform(states),
        np.zeros((n, 4, 4), np.uint8),
        np.ones((n, 2), bool) if seen is None else seen,
        None if std is None else np.array(std, float),
    )


def stands(answer: Reconstruction, recorded_gravity: np.ndarray | None = None, **settings) -> Placement:
    found = estimate_joint_range(answer, Overlap(answer.articulation))
    return place_parts(answer, found, PlacementSettings(**settings), gravity=recorded_gravity)


def carve(answer: Reconstruction, *settings) -> tuple[Articulation, dict, float]:
    """The parts carved, the report, and how deep they are in each other at most at 47 states of the range."""
    found = estimate_joint_range(answer, Overlap(answer.articulation))
    parts, report = carve_parts(answer.articulation, found, TOLERANCE, *settings)
    return parts, report, Overlap(parts).max_depth(np.linspace(found.low, found.high, 47))


def test_a_box_with_a_lid_stands_on_its_base_closed_at_zero():
    answer = seen_as(lidded(0.5), np.linspace(0, 0.6, 9) - 0.25)
    placement = stands(answer)
    base = placement.reference.vertices
    np.testing.assert_allclose([base.min(0), base.max(0)], [[-0.1, -0.075, 0], [0.1, 0.075, 0.1]], atol=1e-9)
    assert placement.report["up"]["how"] == "resting pose" and placement.report["up"]["carried_by"] == "reference"
    # an axis's line, its sign, and the frame: the lid opens upwards by positive states
    assert placement.joint.lower == 0 and placement.joint.upper == pytest.approx(0.6)
    assert placement.state_zero == pytest.approx(0.25)
    lid = placement.moving.moved(se3.pose(np.eye(3), placement.joint.pivot))
    opened = lid.moved(placement.joint.transform(0.5)).vertices
    assert opened[:, 2].max() > 0.15 and lid.vertices[:, 2].min() > 0.0999
    level = answer.articulation.moved(se3.inverse(placement.T_canonical_reference))
    np.testing.assert_allclose(placement.joint.transform(0.3), level.joint.transform(0.3), atol=1e-9)
    np.testing.assert_allclose(lid.vertices, level.posed(np.eye(4), -placement.state_zero)[1].vertices, atol=1e-9)


def test_up_that_is_given_wins_and_gravity_is_given_in_the_cameras_axes():
    answer = seen_as(lidded(), np.linspace(0, 1.2, 9), tilt=0.4)
    up = stands(answer, up=(2.0, 0.0, 0.0))
    np.testing.assert_allclose(up.T_canonical_reference[:3, 2], [1, 0, 0], atol=1e-12)
    assert up.reference.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
    down = 9.81 * np.array([0.0, np.cos(0.4), np.sin(0.4)])
    pulled = stands(answer, gravity=tuple(down))
    np.testing.assert_allclose(pulled.T_canonical_reference[:3, 2], -down / 9.81, atol=1e-12)
    assert (up.report["up"]["how"], pulled.report["up"]["how"]) == ("given", "gravity")


def test_gravity_of_a_reference_part_that_moved_is_refused():
    moved = np.tile(np.eye(4), (9, 1, 1))
    moved[:, 0, 3] = np.linspace(0, 0.05, 9)
    answer = seen_as(lidded(), np.linspace(0, 1.2, 9), Ts_camera_reference=moved)
    with pytest.raises(FreeArtError, match=r"gravity: the reference part moved before the camera by 50 mm"):
        stands(answer, gravity=(0.0, 9.81, 0.0))
    assert stands(answer).report["up"]["how"] == "resting pose"


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"up": (0.0, 0.0, 0.0)}, "up is"),
        ({"gravity": (0.0, np.nan, 1.0)}, "gravity is"),
        ({"up": (0.0, 0.0, 1.0), "gravity": (0.0, 1.0, 0.0)}, "give one of them"),
        ({"zero": "open"}, "zero is 'open'"),
        ({"tolerance_m": 0.0}, "tolerance_m is 0 m"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, message):
    assert_refused(message, lambda: PlacementSettings(**settings).check())


def test_a_pose_in_which_the_lid_would_meet_the_ground_is_none_to_stand_in():
    poses = resting_poses(lidded(), 0.0, 2.5, 0.0)
    on_base = [pose for pose in poses if pose.up @ [0, 0, 1] > 0.999]
    assert len(on_base) == 1 and on_base[0].support == "reference"
    # the centre of mass is 0.0525 up, 0.075 from the long edges; both parts are solid
    assert on_base[0].tipping == pytest.approx(np.arctan2(0.075, 0.055), abs=0.01)
    # it does not stand on the side to which the lid opens: the lid sweeps below it
    assert not [pose for pose in poses if pose.up @ [1, 0, 0] > 0.999 and pose.support == "reference"]


@pytest.mark.parametrize("zero, expected", [("first", 0.0), ("lower", -0.5), ("upper", 0.7), ("closed", -0.5)])
def test_zero_is_where_it_is_asked(zero, expected):
    answer = seen_as(lidded(0.5), np.linspace(-0.5, 0.7, 9))
    placement = stands(answer, zero=zero)
    assert placement.state_zero == pytest.approx(-expected)
    assert (placement.joint.lower, placement.joint.upper) == pytest.approx((-0.5 - expected, 0.7 - expected))


def test_a_lid_that_closes_by_positive_states_has_its_zero_at_the_upper_end():
    parts = lidded(0.9)
    parts = replace(parts, joint=replace(parts.joint, axis=-parts.joint.axis))
    placement = stands(seen_as(parts, np.linspace(0, 0.9, 9)))
    assert (placement.joint.lower, placement.joint.upper) == pytest.approx((-0.9, 0.0))
    assert placement.report["zero"] == {"asked": "closed", "end": "upper"}


def test_a_wild_frame_in_doubt_does_not_widen_the_range_and_believed_ones_are_inside():
    states = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.5, -0.9])
    std = np.array([0.002, 0.002, 0.002, 0.002, 0.002, 0.6, 0.6])
    found = estimate_joint_range(seen_as(lidded(0.2), states, std), None)
    assert (found.low, found.high) == pytest.approx((0.0, 0.8))
    assert robust_maximum(states, std)[0] == 0.8
    assert ((states - 2 * std <= found.high) & (states + 2 * std >= found.low)).all()


def test_an_end_within_its_doubt_of_contact_is_the_contact():
    """Seen were -0.49 to 0.3 with doubts of 0.01: the lid, open by 0.5 at state zero, touches at -0.5."""
    states = np.linspace(-0.51, 0.3, 9)
    answer = seen_as(lidded(0.5), states, np.full(9, 0.02))
    found = estimate_joint_range(answer, Overlap(answer.articulation))
    assert (found.low_by, found.high_by) == ("contact", "seen")
    assert found.low == pytest.approx(-0.5, abs=1.2 * TOLERANCE / 0.2)  # the lid's rim is 0.2 from its hinge


def test_a_hidden_end_stops_where_the_parts_touch():
    seen = np.ones((9, 2), bool)
    seen[:2, 1] = False
    states = np.append([-0.7, -0.6], np.linspace(-0.3, 0.4, 7))
    answer = seen_as(lidded(0.5), states, np.where(seen.all(1), 0.001, np.nan), seen=seen)
    found = estimate_joint_range(answer, Overlap(answer.articulation))
    assert found.low_by == "contact" and found.low == pytest.approx(-0.5, abs=0.005)


@pytest.mark.parametrize("patched", ["reference", "moving"])
def test_a_guessed_surface_ends_no_range(patched):
    """The same lid: where nobody saw a part's faces, they may be wherever they were put to close it."""
    seen = np.ones((9, 2), bool)
    seen[:2, 1] = False
    states = np.append([-0.7, -0.6], np.linspace(-0.3, 0.4, 7))
    answer = seen_as(lidded(0.5), states, np.where(seen.all(1), 0.001, np.nan), seen=seen)
    parts = answer.articulation
    observed = {name: np.full(len(parts.part(name).faces), name != patched) for name in ("reference", "moving")}
    found = estimate_joint_range(answer, Overlap(parts, observed))
    assert (found.low, found.low_by) == (-0.7, "hidden")
    assert Overlap(parts, observed).depths(-0.7).max() == 0
    assert Overlap(parts).depths(-0.7).max() > 0.01


def test_depth_of_a_box_in_a_box():
    slide = Joint("slide", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), -np.inf, np.inf)
    overlap = Overlap(Articulation(slide, box((0.1, 0.1, 0.1)), box((0.04, 0.04, 0.04), (0.075, 0, 0))))
    for state, depth in ((0.0, 0), (-0.003, 0), (-0.005, 0), (-0.012, 0.007), (0.0, 0)):  # in any order
        assert overlap.depths(state).max() == pytest.approx(depth, abs=3e-4)
    assert overlap.depths(-0.012, 0.0071).max() == 0
    for states in ([0.0, -0.003, -0.012, -0.002], [-0.012, 0.0], [-0.011, -0.012]):
        assert overlap.max_depth(np.array(states)) == pytest.approx(0.007, abs=3e-4)


def test_parts_in_each_other_are_carved_to_half_a_millimetre_and_say_so(tmp_path: Path):
    """A lid that everywhere sinks 4 mm into the box, as in reconstructions that are solid where nobody looked."""
    parts = lidded(0.3, gap=-0.004)
    answer = seen_as(parts, np.linspace(-0.3, 0.5, 9))
    apart, facts, deepest = carve(answer)
    assert facts["before_carving_m"] > 0.003 and facts["carved"] is not None
    assert deepest <= 1.1 * TOLERANCE
    for mesh in (apart.reference, apart.moving):
        assert make_solid(mesh) is not None
    assert carve(answer, False)[2] > 0.003


def test_open_parts_are_not_carved_and_say_why():
    parts = lidded(0.3, gap=-0.004)
    parts = replace(parts, moving=parts.moving.with_faces(np.arange(12) > 1))
    _, facts, _ = carve(seen_as(parts, np.linspace(-0.3, 0.5, 9)))
    assert facts["carved"] is None and facts["not_carved_because"] == "the moving part is not closed"


def test_a_thin_drawer_leaves_nothing_standing_in_its_way():
    """A drawer of 1 mm walls pulled by 0.2 m out of a block that fills its place: copies of it leave films between."""
    slide = Joint("slide", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), -np.inf, np.inf)
    tray = trimesh.boolean.difference(
        [
            trimesh.creation.box((0.2, 0.1, 0.05)),
            trimesh.creation.box((0.198, 0.098, 0.05), se3.pose(np.eye(3), (0, 0, 0.001))),
        ]
    )
    parts = Articulation(slide, box((0.3, 0.2, 0.1), (-0.05, 0, 0)), Mesh(tray.vertices, tray.faces))
    cut = carve_overlap(parts, 0.0, 0.2, TOLERANCE, Overlap(parts))
    assert cut.name == "reference"
    apart = replace(parts, reference=cut.mesh)
    assert Overlap(apart).max_depth(np.linspace(0, 0.2, 37)) <= TOLERANCE
    assert cut.volume == pytest.approx(0.2 * 0.1 * 0.05, rel=0.02)  # what the front wall sweeps, and the floor


def test_what_would_lose_most_of_itself_is_not_carved():
    slide = Joint("slide", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), -np.inf, np.inf)
    parts = Articulation(slide, box((0.1, 0.1, 0.1)), box((0.097, 0.097, 0.097)))
    assert "would be cut away" in carve_overlap(parts, 0.0, 0.02, TOLERANCE, Overlap(parts))


def test_depths_grow_with_the_scale(tmp_path: Path):
    answer = seen_as(lidded(0.3, gap=-0.004), np.linspace(-0.3, 0.5, 9))
    settings = ExportSettings(usd=False, scale=10.0)
    facts = export_result(answer, tmp_path / "a", settings).source["penetration"]
    assert facts["tolerance_m"] == pytest.approx(10 * TOLERANCE) and 0.03 < facts["before_carving_m"] < 0.05


def test_an_asset_stands_says_so_and_reaches_every_believed_state(tmp_path: Path):
    states = np.linspace(-0.2, 0.6, 9)
    asset = export_result(seen_as(lidded(0.2, gap=0.001), states), tmp_path / "a", ExportSettings(usd=False))
    document = json.loads((tmp_path / "a" / "asset.json").read_text())["source"]
    assert document["up"]["how"] == "resting pose" and document["zero"]["end"] == "lower"
    assert document["penetration"]["deepest_m"] <= document["penetration"]["tolerance_m"]
    limit = ET.parse(asset.urdf).find("joint/limit")
    lower, upper = float(limit.get("lower")), float(limit.get("upper"))
    assert lower == 0
    assert (states + asset.state_zero >= lower - 1e-9).all() and (states + asset.state_zero <= upper + 1e-9).all()
    base = trimesh.load_mesh(tmp_path / "a" / "meshes" / "reference.obj", process=False)
    assert base.bounds[0][2] == pytest.approx(0, abs=1e-4)
    assert base.bounds.mean(0)[:2] == pytest.approx([0, 0], abs=1e-4)
