"""The numerics of the pose adjustments against their plain, dense definitions."""

import numpy as np
import pytest

from freeart21 import se3
from freeart21.joint import Joint
from reconstruct import poses
from reconstruct.poses import JointedPoses
from reconstruct.settings import PoseSettings


def turning(n=40, seed=0, step=0.06):
    """Poses (n, 4, 4) that turn about a wandering axis."""
    rng = np.random.default_rng(seed)
    twists = np.cumsum(rng.normal(0, step, (n, 6)), 0)
    return se3.exp_se3(twists)


class Springs:
    """Stands in for the evidence: the same random positive terms for a pair, whenever asked."""

    def register(self, source, target, T, samples, gate, labels, part):
        rows = np.random.default_rng(part).normal(size=(len(source), 8, 6))
        return rows.transpose(0, 2, 1) @ rows, rows.sum(1), np.ones((len(source), 4))


def equations(Ts, seen, part):
    pairs = poses.choose_pairs(Ts, seen, PoseSettings())
    return pairs, poses._normal_equations(Springs(), None, part, Ts, {}, *pairs, 4.0)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_jacobian_is_the_derivative_of_the_moving_part(kind):
    rng = np.random.default_rng(2)
    joint = Joint("j", kind, np.array([0.0, 0.6, 0.8]), np.array([0.1, 0.2, 0.0]), 0, 1)
    now = JointedPoses(joint, rng.uniform(0, 1, 5), turning(5), np.ones(5), 0.0)
    M, across = poses.joint_jacobian(now)
    x = 1e-6 * rng.normal(size=M.shape[1])
    moved = se3.log_se3(poses.apply_joint_step(now, x, across, 1.0).Ts_moving @ se3.inverse(now.Ts_moving))
    np.testing.assert_allclose(moved.ravel(), M @ x, atol=1e-9)


def jointed_equations(kind="revolute", n=25):
    Ts, seen = turning(n), np.ones((n, 2), bool)
    seen[7, 1] = False
    joint = Joint("j", kind, np.array([0.0, 0.6, 0.8]), np.array([0.1, 0.2, 0.0]), 0, 1)
    now = JointedPoses(joint, np.linspace(0, 1, n), Ts, np.ones(n), 0.0)
    _, (A0, _, _) = equations(Ts, seen[:, 0], 1)
    _, (A1, _, _) = equations(now.Ts_moving, seen[:, 1], 2)
    M, across = poses.joint_jacobian(now)
    own = np.eye(6 * n, M.shape[1])
    return np.asarray(own.T @ A0 @ own + M.T @ A1 @ M), now, seen, M.toarray(), across


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("part", [0, 1])
def test_deviations_of_the_joint_are_those_of_random_solutions_in_the_frame_of_a_part(kind, part):
    """Drawn from all solutions with the video's own gauge, moved into the frame of a part, and measured there."""
    A, now, seen, M, across = jointed_equations(kind)
    n, rng, centre = len(now.Ts), np.random.default_rng(5), np.array([0.3, -0.1, 0.2])
    eigenvalues, vectors = np.linalg.eigh(A)
    known = eigenvalues > 1e-9 * eigenvalues.max()
    draws = rng.normal(size=(4000, known.sum())) / np.sqrt(eigenvalues[known]) @ vectors[:, known].T
    frames = np.flatnonzero(seen[:, part])
    Ts = (now.Ts, now.Ts_moving)[part]
    twists = draws[:, : 6 * n] if part == 0 else draws @ M.T
    back = se3.adjoint(se3.inverse(Ts[frames]))
    mean = np.einsum("fij,dfj->di", back, twists.reshape(len(draws), n, 6)[:, frames]) / len(frames)
    v, w = mean[:, :3], mean[:, 3:]  # the part's frame moved by this twist, and the joint's numbers in it with it
    axis = draws[:, 7 * n : 7 * n + 2] @ across + np.cross(w, now.joint.axis)
    expected = np.sqrt((axis**2).sum(1).mean() / 2)
    found = poses._joint_std(A, now, seen, centre, 1.0)
    assert found[part, 0] == pytest.approx(expected, rel=0.05)
    if kind == "prismatic":
        assert np.isnan(found[:, 1]).all()
        return
    near = now.joint.pivot + ((centre - now.joint.pivot) @ now.joint.axis) * now.joint.axis
    line = draws[:, 7 * n + 2 :] @ across + np.cross(w, now.joint.pivot) + v
    line += ((near - now.joint.pivot) @ now.joint.axis) * axis
    line -= np.outer(line @ now.joint.axis, now.joint.axis)
    assert found[part, 1] == pytest.approx(np.sqrt((line**2).sum(1).mean() / 2), rel=0.05)
    assert poses._joint_std(A, now, seen, centre, 9.0) == pytest.approx(3 * found)
