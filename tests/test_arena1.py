"""arena-1 by closed forms, by the laws of a metric, and against the package `articulatearena`."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from perturbed import (
    KINDS,
    lid_centre,
    other_type,
    reversed_axis,
    shifted,
    tilted,
    values_of,
)
from score_files import write_asset
from synthetic_case import (
    in_frame,
    make_recording,
    make_truth,
    random_pose,
    truth_as_answer,
    with_joint,
    with_names_exchanged,
)

from freeart21.joint import Joint
from freeart21.mesh import Mesh
from leaderboard.protocols.arena1 import (
    ARENA_1,
    KAPPA,
    end_twists,
    joint_distance,
    pair_distance,
    solid_from_mesh,
    still_distance,
)
from leaderboard.sequence_score import SequenceScorer

scored = functools.partial(values_of, ARENA_1)
IDS = ("twist", "twist_shown", "twist_compact")
BOX = (0.36, 0.26, 0.02)
"""Metres: the made-up moving part."""


def body(sides=BOX, centre=(0.1, -0.2, 0.3)):
    made = trimesh.creation.box(sides)
    return Mesh(made.vertices + np.asarray(centre), made.faces)


def random_joint(rng, kind=None):
    axis = rng.normal(size=3)
    low, high = np.sort(rng.normal(size=2))
    return Joint("j", kind or rng.choice(KINDS), axis / np.linalg.norm(axis), rng.normal(size=3) * 0.3, low, high)


# ---- the norm


def test_the_norm_is_the_root_mean_square_speed_of_the_parts_points():
    solid, n = solid_from_mesh(body()), 24
    grid = (np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n - 0.5] * 3, indexing="ij"), -1) * BOX).reshape(-1, 3)
    points = grid + np.array((0.1, -0.2, 0.3))
    for twist in np.random.default_rng(0).normal(size=(5, 6)):
        speeds = np.linalg.norm(twist[:3] + np.cross(twist[3:], points), axis=1)
        assert solid.square(twist) == pytest.approx(np.mean(speeds**2), rel=2e-3)


def test_an_open_mesh_is_taken_as_its_hull_and_a_flat_one_as_a_sheet():
    closed = body()
    holed = Mesh(closed.vertices, closed.faces[2:])
    assert np.allclose(solid_from_mesh(holed).inertia, solid_from_mesh(closed).inertia)
    a, b, _ = BOX
    for flat in (Mesh(closed.vertices * [1, 1, 0], closed.faces), body((a, b, 1e-7), (0.1, -0.2, 0))):
        sheet = solid_from_mesh(flat)
        assert np.allclose(sheet.centre, (0.1, -0.2, 0), atol=1e-6)
        assert np.allclose(sheet.inertia / sheet.mass, np.diag([b * b, a * a, a * a + b * b]) / 12, atol=1e-6)


# ---- closed forms


def test_a_limit_wrong_by_x_costs_x_times_the_size_of_the_twist():
    truth = make_truth("prismatic")
    joint = truth.articulation.joint
    further = with_joint(truth_as_answer(truth), replace(joint, upper=joint.upper + 0.04))
    assert scored(truth, further)["twist"] == pytest.approx(0.04)
    assert scored(truth, further)["twist_shown"] == pytest.approx(0, abs=1e-12)  # what the video shows is right
    both = with_joint(truth_as_answer(truth), replace(joint, lower=joint.lower - 0.03, upper=joint.upper + 0.04))
    assert scored(truth, both)["twist"] == pytest.approx(0.05)


@pytest.mark.parametrize("shift", [1e-4, 0.05])
def test_shifting_the_axis_costs_the_shift_times_the_angles(shift):
    truth = make_truth()
    joint = truth.articulation.joint
    size = np.hypot(joint.lower, joint.upper)  # both ends are off by their angle times the shift, and nothing turns
    assert scored(truth, shifted(truth, across=shift))["twist"] == pytest.approx(shift * size, rel=1e-6)
    assert scored(truth, shifted(truth, along=0.7))["twist"] == pytest.approx(0, abs=1e-9)
    assert scored(truth, shifted(truth, across=shift))["twist_shown"] == pytest.approx(
        shift * np.hypot(truth.states.min(), truth.states.max()), rel=1e-6
    )


def test_tilting_a_hinge_costs_the_speed_of_the_part_about_the_difference():
    truth = make_truth()
    joint, answer = truth.articulation.joint, tilted(truth, 10.0)
    solid = solid_from_mesh(truth.articulation.moving)
    other = answer.articulation.joint
    off = other.screw - joint.screw  # both ends, times their angle
    expected = np.sqrt(solid.square(off)) * np.hypot(joint.lower, joint.upper)
    assert scored(truth, answer)["twist"] == pytest.approx(expected)
    turn = other.axis - joint.axis
    speed = np.cross(turn, lid_centre(truth) - other.pivot)
    assert solid.square(off) == pytest.approx(turn @ solid.inertia @ turn / solid.mass + speed @ speed)


def test_a_wrong_type_costs_what_the_two_motions_differ_by():
    truth = make_truth()
    joint = truth.articulation.joint
    answer = other_type(truth)
    solid = solid_from_mesh(truth.articulation.moving)
    zero = int(np.argmin(np.abs(truth.states)))
    slide = replace(
        answer.articulation.joint,
        lower=joint.lower - answer.states[zero],
        upper=joint.upper - answer.states[zero],
    )
    assert scored(truth, answer)["twist"] == pytest.approx(
        pair_distance(end_twists(joint, solid), end_twists(slide, solid), solid.square)
    )
    assert scored(truth, answer)["joint_type"] == 0


# ---- what is the same answer, and what is not


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_the_same_motion_costs_nothing(kind):
    truth = make_truth(kind)
    joint, answer = truth.articulation.joint, truth_as_answer(truth)
    offset = with_joint(answer, replace(joint, lower=joint.lower + 0.4, upper=joint.upper + 0.4), truth.states + 0.4)
    for same in (
        answer,
        reversed_axis(truth),
        offset,
        with_names_exchanged(answer),
        in_frame(answer, random_pose(np.random.default_rng(2), 3.0)),
    ):
        values = scored(truth, same)
        assert all(values[id] == pytest.approx(0, abs=1e-6) for id in IDS), values


def test_it_is_a_metric():
    rng, solid = np.random.default_rng(0), solid_from_mesh(body())
    for _ in range(200):
        a, b, c = (random_joint(rng) for _ in range(3))
        for kappa in (None, KAPPA):
            ab, bc, ac = (joint_distance(x, y, solid, kappa) for x, y in ((a, b), (b, c), (a, c)))
            assert ab == pytest.approx(joint_distance(b, a, solid, kappa), abs=1e-12) and ac <= ab + bc + 1e-12
        assert joint_distance(a, a.reversed(), solid) == pytest.approx(0, abs=1e-12)
        assert joint_distance(a, b, solid, KAPPA) <= 2 * np.sqrt(2)


def test_joints_without_limits():
    truth = make_truth()
    joint = truth.articulation.joint
    endless = replace(joint, lower=-np.inf, upper=np.inf)
    row = SequenceScorer(ARENA_1, make_recording(truth), truth).measure_row(
        with_joint(truth_as_answer(truth), endless), Path("none"), "files"
    )
    assert row.values["twist"] == SequenceScorer(ARENA_1, make_recording(truth), truth).penalties()["twist"]
    assert "no limits" in row.notes[0] and row.values["twist_compact"] > 1
    turning = replace(truth, articulation=replace(truth.articulation, joint=endless))
    case = SequenceScorer(ARENA_1, make_recording(turning), turning)
    assert case.penalised_row("failed", "declared").values["twist"] is None
    values = case.measure_row(truth_as_answer(turning), Path("none"), "files").values
    assert values["twist"] is None and values["twist_compact"] == pytest.approx(0, abs=1e-9)
    solid = solid_from_mesh(truth.articulation.moving)
    far = replace(joint, lower=-1e6, upper=1e6)
    assert joint_distance(endless, far, solid, KAPPA) == pytest.approx(0, abs=1e-9)


# ---- limits of an asset


# ---- against the package


def test_ours_is_the_packages_number():
    package = pytest.importorskip("articulatearena")
    rng = np.random.default_rng(1)
    for _ in range(200):
        solid = solid_from_mesh(body(rng.uniform(0.02, 1.0, 3), rng.normal(size=3)))
        a, b = random_joint(rng), random_joint(rng)
        norm = package.make_kinetic_energy_norm(package.LinkInertia(solid.mass, solid.centre, solid.inertia))
        theirs = []
        for joint in (a, b):
            twist = package.screw_twist(joint.axis, joint.pivot, joint.type)
            theirs.append(package.joint_to_endpoint_pair(package.Joint(twist, joint.lower, joint.upper, joint.type)))
        four = [end.data for pair in theirs for end in (pair.u, pair.v)]
        ours = pair_distance(end_twists(a, solid), end_twists(b, solid), solid.square)
        assert ours == pytest.approx(package.joint_metric(*four, norm), rel=1e-12)
        compact = pair_distance(end_twists(a, solid, KAPPA), end_twists(b, solid, KAPPA), solid.square)
        assert compact == pytest.approx(package.compactified_joint_metric(*four, norm, KAPPA), rel=1e-12)
        assert still_distance(a, solid) == pytest.approx(package.cost_to_fixed((four[0], four[1]), norm), rel=1e-12)


def test_the_body_is_the_packages_body(tmp_path):
    pytest.importorskip("articulatearena")
    from articulatearena.read.inertia_loader import load_joint_child_inertia

    joint = make_truth().articulation.joint
    write_asset(tmp_path, joint)
    theirs = load_joint_child_inertia(tmp_path / "made.urdf", joint.name)
    ply = trimesh.load(tmp_path / "meshes" / "lid.ply", force="mesh")
    ours = solid_from_mesh(Mesh(ply.vertices, ply.faces))
    assert ours.mass == pytest.approx(theirs.mass) and np.allclose(ours.centre, theirs.com, atol=1e-9)
    assert np.allclose(ours.inertia, theirs.inertia, rtol=1e-9, atol=1e-12)
