"""Closed forms and robust fits of the joint, against exact and spoiled poses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusal import assert_refused

from freeart21 import se3
from freeart21.joint import JOINT_TYPES, Joint
from freeart21.joint_fit import (
    find_inlier_poses,
    fit_joint,
    fit_joint_of_type,
    paper_joint_type,
    prismatic_axis,
    revolute_axis,
    revolute_pivot,
    rotation_amplitude,
    translation_linearity,
)
from reconstruct import joint_type
from reconstruct.settings import JointSettings, ReconstructSettings

TRACKS = Path(__file__).resolve().parents[2] / "shared" / "failing" / "import"


def random_joint(rng, kind):
    axis = rng.normal(size=3)
    return Joint("j", kind, axis / np.linalg.norm(axis), rng.uniform(-0.5, 0.5, 3), -10, 10)


def relative_poses(joint, states, rng, noise=0.0, outliers=0.0, gauge=True):
    """T_reference_moving of an ideal joint with any constant offset, left-perturbed by noise and gross outliers."""
    G = se3.exp_se3(np.concatenate([rng.uniform(-0.3, 0.3, 3), rng.uniform(-1, 1, 3)])) if gauge else np.eye(4)
    Ts = joint.transform(states) @ G
    bad = rng.permutation(len(states))[: int(outliers * len(states))]
    wobble = noise * rng.normal(size=(len(states), 6)) * np.repeat([0.2, 1.0], 3)
    wobble[bad] += rng.normal(size=(len(bad), 6)) * np.repeat([0.1, 0.5], 3)
    return Ts @ se3.exp_se3(wobble)


def both_fits(Ts, centre, lever):
    return {kind: fit_joint_of_type(Ts, kind, centre, lever) for kind in JOINT_TYPES}


def errors(fit, joint, states):
    """Axis (rad), distance of the lines, state error with sign and offset removed."""
    sign = np.sign(fit.axis @ joint.axis)
    d = fit.pivot - joint.pivot
    off = sign * fit.states - states
    return (
        np.arccos(min(1.0, abs(fit.axis @ joint.axis))),
        np.linalg.norm(d - (d @ joint.axis) * joint.axis),
        np.abs(off - np.median(off)),
    )


@pytest.mark.parametrize("seed", range(5))
def test_closed_forms_are_exact_on_exact_poses(seed):
    rng = np.random.default_rng(seed)
    joint = random_joint(rng, "revolute")
    Ts = relative_poses(joint, rng.uniform(-0.6, 0.6, 30), rng)
    axis = revolute_axis(Ts[:, :3, :3])
    assert abs(axis @ joint.axis) == pytest.approx(1, abs=1e-12)
    pivot, v = revolute_pivot(Ts, axis)
    d = pivot - joint.pivot
    assert np.linalg.norm(d - (d @ joint.axis) * joint.axis) < 1e-9
    assert abs(pivot @ axis) < 1e-9
    model = pivot + Ts[:, :3, :3] @ v
    assert np.ptp((Ts[:, :3, 3] - model) @ axis) < 1e-9
    slide = random_joint(rng, "prismatic")
    direction, _ = prismatic_axis(slide.transform(rng.uniform(0, 0.3, 30))[:, :3, 3])
    assert abs(direction @ slide.axis) == pytest.approx(1, abs=1e-12)


def test_a_part_that_turns_several_times_keeps_counting():
    rng = np.random.default_rng(0)
    joint, states = random_joint(rng, "revolute"), np.linspace(0, 15, 80)
    fit = both_fits(relative_poses(joint, states, rng), np.array([0.1, 0, 0]), 0.1)["revolute"]
    assert fit.residual < 1e-9 and errors(fit, joint, states)[2].max() < 1e-6


def test_small_range_revolute_with_a_small_lever():
    rng = np.random.default_rng(3)
    joint = Joint("j", "revolute", np.array([0, 0, 1.0]), np.array([0.02, 0.01, 0]), -1, 1)
    states = np.radians(8) * np.sin(np.linspace(0, 9, 80))
    fits = both_fits(relative_poses(joint, states, rng, noise=0.002), np.zeros(3), 0.05)
    assert np.degrees(errors(fits["revolute"], joint, states)[0]) < 1.0
    assert fits["prismatic"].residual > 2 * fits["revolute"].residual


def test_an_arc_of_89_degrees_is_a_hinge_where_the_paper_says_slide(monkeypatch):
    rng = np.random.default_rng(0)
    joint = Joint("j", "revolute", np.array([0, 1.0, 0]), np.array([0.3, 0, 0]), -2, 2)
    states = np.radians(89) * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 60)))
    Ts = relative_poses(joint, states, rng, noise=0.002, gauge=False)
    fits = both_fits(Ts, np.zeros(3), 0.2)
    assert fits["revolute"].residual < 0.002 and fits["prismatic"].residual > 0.05
    monkeypatch.setattr("freeart21.joint_fit.MAX_LINEARITY", 0.2)
    assert translation_linearity(Ts) < 0.2 and paper_joint_type(Ts) == "prismatic"


@pytest.mark.parametrize("turned, kind", [(2.4, "revolute"), (0.1, "prismatic")])
def test_under_the_papers_rule_its_type_alone_is_adjusted(turned, kind, monkeypatch):
    """From its fit, or from where it stands; 0.1 rad are too few for that rule to call it a hinge."""
    rng = np.random.default_rng(2)
    hinge = Joint("j", "revolute", np.array([0, 0, 1.0]), np.array([0.2, 0, 0]), -3, 3)
    states = np.linspace(0, turned, 30)
    Ts = np.stack([np.tile(np.eye(4), (30, 1, 1)), relative_poses(hinge, states, rng)])
    settings = ReconstructSettings(joint=JointSettings(type_rule="paper"))
    starts = []

    def adjustment(evidence, labels, start, *rest):
        starts.append(start)
        return start

    monkeypatch.setattr(joint_type, "joint_adjustment", adjustment)
    arguments = (None, None, Ts, np.ones((30, 2), bool), rng.normal(size=(50, 3)), np.ones(30, bool), settings, rng)
    found = joint_type.choose_joint_type(*arguments)
    assert found.joint.type == kind and len(starts) == 1
    assert joint_type.choose_joint_type(*arguments, found) is found
    other = replace(found, joint=replace(found.joint, type="prismatic" if kind == "revolute" else "revolute"))
    assert joint_type.choose_joint_type(*arguments, other).joint.type == kind and len(starts) == 3


def test_paper_rule_on_clear_cases():
    rng = np.random.default_rng(1)
    hinge = Joint("j", "revolute", np.array([0, 0, 1.0]), np.array([0.2, 0, 0]), -3, 3)
    turned = relative_poses(hinge, np.linspace(0, 2.4, 50), rng)
    slid = relative_poses(random_joint(rng, "prismatic"), np.linspace(0, 0.3, 50), rng)
    assert paper_joint_type(turned) == "revolute" and rotation_amplitude(turned) > 50
    assert paper_joint_type(slid) == "prismatic" and rotation_amplitude(slid) < 1e-4
    assert translation_linearity(slid) < 1e-12


def test_two_sigma_filter_names_the_jumps():
    joint = Joint("j", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), 0, 1)
    Ts = joint.transform(np.linspace(0, 0.3, 40))
    Ts[17, :3, 3] += (0, 0.5, 0)
    inliers = find_inlier_poses(Ts)
    assert not inliers[17] and inliers.sum() == 39


# --- the type ---------------------------------------------------------------------------------------------------------


def tracked(kind, rng, *, span, noise_m=0.0, noise_deg=0.0, wild=0.0, n=60, drift=0.0):
    """Poses of a part 0.2 m across against another, by a joint 0.15 m from its middle, and what is true of it. `drift`:
    the tracker errs by a rotation and shift of this size, rad and 0.1 m, that follow the state."""
    axis, centre = rng.normal(size=3), rng.normal(size=3) * 0.1
    axis /= np.linalg.norm(axis)
    home = se3.exp_se3(rng.normal(size=6))
    away = np.cross(axis, rng.normal(size=3))
    joint = Joint("j", kind, axis, se3.transform(home, centre) + 0.15 * away / np.linalg.norm(away), -9, 9)
    states = span * (0.5 - 0.5 * np.cos(np.linspace(0, 0.9 * np.pi, n)))
    middle = se3.pose(np.eye(3), centre)
    noise = rng.normal(size=(n, 6)) * ([noise_m] * 3 + [np.radians(noise_deg)] * 3)
    along = states / span
    bends = np.outer(along, rng.normal(size=6)) + np.outer(along**2, rng.normal(size=6))
    noise += drift * bends * np.repeat([0.1, 1.0], 3)
    motion = joint.transform(states) @ home @ middle @ se3.exp_se3(noise) @ se3.inverse(middle)
    lost = rng.random(n) < wild
    motion[lost] = motion[lost] @ se3.exp_se3(rng.normal(size=(int(lost.sum()), 6)) * [0.2, 0.2, 0.2, 0.5, 0.5, 0.5])
    return joint, states, motion, centre


@pytest.mark.parametrize("kind, span", [("revolute", 1.2), ("revolute", 0.3), ("prismatic", 0.3), ("prismatic", 0.05)])
def test_a_joint_of_exact_poses_is_exact(kind, span):
    joint, states, motion, centre = tracked(kind, np.random.default_rng(1), span=span)
    fit, other = fit_joint(motion, centre, 0.1)
    assert fit.type == kind and fit.residual < 1e-6 and other.residual > 10 * fit.residual
    assert fit.axis == pytest.approx(joint.axis, abs=1e-5)  # states rise, as the true ones do
    assert fit.states == pytest.approx(states - states[0], abs=1e-5)
    if kind == "revolute":
        assert np.linalg.norm(np.cross(fit.pivot - joint.pivot, joint.axis)) < 1e-5
    assert fit.joint().transform(fit.states) @ fit.T_zero == pytest.approx(motion, abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind, span, degrees", [("revolute", 1.2, 2), ("revolute", 0.4, 5), ("prismatic", 0.3, 1.5)])
def test_a_joint_of_noisy_poses_with_some_of_them_lost(kind, span, degrees, seed):
    rng = np.random.default_rng(seed)
    joint, states, motion, centre = tracked(kind, rng, span=span, noise_m=0.003, noise_deg=1, wild=0.05)
    fit, _ = fit_joint(motion, centre, 0.1)
    assert fit.type == kind
    assert np.degrees(np.arccos(min(1, fit.axis @ joint.axis))) < degrees
    off = fit.states - states
    assert np.median(np.abs(off - np.median(off))) < (0.02 if kind == "revolute" else 0.004)
    if kind == "revolute":
        assert np.linalg.norm(np.cross(fit.pivot - joint.pivot, joint.axis)) < 0.03


@pytest.mark.parametrize("lever", [0.05, 0.2])
@pytest.mark.parametrize("kind, span", [("prismatic", 0.4), ("revolute", 0.8)])
def test_a_tracker_s_drift_makes_no_hinge_of_a_drawer(kind, span, lever):
    """It turns by some 1.5 degrees and bends by some millimetres as the part moves, as real tracks do."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        _, _, motion, centre = tracked(kind, rng, span=span, noise_m=0.001, noise_deg=0.1, drift=0.02, n=50)
        assert fit_joint(motion, centre, lever)[0].type == kind, seed


@pytest.mark.parametrize("track, kind", [("394", "prismatic"), ("408", "prismatic"), ("391", "revolute")])
def test_two_drawers_and_a_door_of_a_real_kitchen(track, kind):
    """Tracks of tum-vision/articulation: position and quaternion x y z w a line."""
    file = TRACKS / f"M2U00{track}.log"
    if not file.is_file():
        pytest.skip("outside data are not here")
    rows = np.loadtxt(file)
    fit, _ = fit_joint(se3.pose_from_wxyz(rows[:, :3], rows[:, [6, 3, 4, 5]]), np.zeros(3), 0.05)
    assert fit.type == kind
    if kind == "prismatic":
        assert 0.42 < np.ptp(fit.states) < 0.47


def test_parts_that_do_not_move_have_no_joint():
    still = np.repeat(se3.exp_se3(np.arange(6.0))[None], 10, 0)
    assert_refused("does not move", fit_joint, still, np.zeros(3), 0.1)
    assert_refused("3 poses are too few", fit_joint, still[:3], np.zeros(3), 0.1)
