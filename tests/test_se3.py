"""Group laws of SE(3), at the extremes."""

import numpy as np
import pytest
from refusal import assert_refused

from freeart21 import se3

ANGLES = [0.0, 1e-9, 1e-5, 0.99e-4, 1.01e-4, 1e-2, 1.0, 3.0, np.pi - 1e-6, np.pi - 1e-12, np.pi]


def _twists(angle: float, n: int = 20) -> np.ndarray:
    rng = np.random.default_rng(0)
    w = rng.standard_normal((n, 3))
    w[:3] = np.eye(3)  # at pi about a coordinate axis two quaternion entries vanish
    w *= angle / np.linalg.norm(w, axis=-1, keepdims=True)
    return np.concatenate([rng.standard_normal((n, 3)), w], -1)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_undoes_log(angle):
    T = se3.exp_se3(_twists(angle))
    np.testing.assert_allclose(se3.exp_se3(se3.log_se3(T)), T, atol=1e-11)


@pytest.mark.parametrize("angle", ANGLES[:-2])
def test_log_undoes_exp_below_pi(angle):
    twists = _twists(angle)
    np.testing.assert_allclose(se3.log_se3(se3.exp_se3(twists)), twists, atol=1e-8)


def test_log_at_pi_has_angle_pi():
    np.testing.assert_allclose(se3.rotation_angle(se3.exp_so3(_twists(np.pi)[:, 3:])), np.pi, atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_se3_matches_the_matrix_exponential(angle):
    from scipy.linalg import expm

    for twist in _twists(angle, 5):
        X = np.zeros((4, 4))
        X[:3, :3], X[:3, 3] = se3.hat(twist[3:]), twist[:3]
        np.testing.assert_allclose(se3.exp_se3(twist), expm(X), atol=1e-12)


def test_inverse_and_associativity():
    A, B, C = (se3.exp_se3(_twists(a)) for a in (0.5, 2.0, 3.1))
    np.testing.assert_allclose(A @ se3.inverse(A), np.broadcast_to(np.eye(4), A.shape), atol=1e-14)
    np.testing.assert_allclose(se3.inverse(A @ B @ C), se3.inverse(C) @ se3.inverse(B) @ se3.inverse(A), atol=1e-13)


def test_transform_of_a_product_is_the_product_of_transforms():
    A, B = (se3.exp_se3(_twists(a)) for a in (0.5, 2.0))
    points = np.random.default_rng(1).standard_normal((20, 7, 3))
    np.testing.assert_allclose(se3.transform(A @ B, points), se3.transform(A, se3.transform(B, points)), atol=1e-13)
    np.testing.assert_allclose(se3.transform(A[0], points[0]), se3.transform(A, points)[0], atol=1e-15)


def test_adjoint_moves_twists_between_frames():
    T, x = se3.exp_se3(_twists(1.2)), _twists(0.7)
    moved = np.einsum("nij,nj->ni", se3.adjoint(T), x)
    np.testing.assert_allclose(T @ se3.exp_se3(x) @ se3.inverse(T), se3.exp_se3(moved), atol=1e-12)


def test_projection_finds_the_nearest_rotation_even_of_a_reflection():
    rng = np.random.default_rng(0)
    for M in [rng.standard_normal((3, 3)) for _ in range(20)] + [np.diag([1.0, 1.0, -1.0])]:
        R = se3.project_so3(M)
        assert np.linalg.det(R) == pytest.approx(1)
        others = se3.exp_so3(rng.standard_normal((500, 3)))
        assert np.linalg.norm(R - M) <= np.linalg.norm(others - M, axis=(-1, -2)).min() + 1e-12


def test_mean_pose_ignores_a_tenth_of_wild_poses():
    rng = np.random.default_rng(0)
    centre = se3.exp_se3([1, 2, 3, 0.5, -2.0, 1.0])
    Ts = centre @ se3.exp_se3(1e-3 * rng.standard_normal((100, 6)))
    Ts[::10] = se3.exp_se3(3 * rng.standard_normal((10, 6)))
    assert np.abs(se3.log_se3(se3.inverse(centre) @ se3.mean_pose(Ts))).max() < 1e-3
    assert np.abs(se3.log_se3(se3.inverse(centre) @ se3.mean_pose(Ts, sigma=None))).max() > 0.05


def test_quaternions_are_wxyz_and_round_trip():
    np.testing.assert_allclose(
        se3.pose_from_wxyz([0, 0, 0], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])[:3, 0], [0, 1, 0], atol=1e-15
    )
    T = se3.exp_se3(np.concatenate([_twists(a) for a in (0.0, 1e-9, 1.0, np.pi)]))
    np.testing.assert_allclose(se3.pose_from_wxyz(T[:, :3, 3], se3.wxyz(T)), T, atol=1e-12)


def test_check_poses_names_the_bad_one():
    Ts = np.stack([np.eye(4)] * 3)
    Ts[2, 0, 0] = -1  # a mirror
    assert_refused(r"poses\[2\] is not a rigid pose", se3.check_poses, "poses", Ts)
    assert_refused(r"shape \(3, 3\), expected", se3.check_poses, "poses", np.eye(3))
