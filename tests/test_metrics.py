"""Each number against a closed form, or against a slow and obvious way to the same."""

import numpy as np
import pytest
import trimesh

from freeart21 import se3
from freeart21.mesh import Mesh
from leaderboard import metrics
from leaderboard.surface import Surface

X, Y, Z = np.eye(3)


@pytest.mark.parametrize("angle", [0, 1e-9, 1e-3, 0.7, np.pi / 2 - 1e-9, np.pi / 2])
def test_axis_error_is_the_angle_whatever_the_signs(angle):
    b = np.array([np.cos(angle), np.sin(angle), 0])
    for sign in (1, -1):
        assert metrics.axis_error(X, sign * b) == pytest.approx(angle, abs=1e-15)
        assert metrics.axis_error(sign * b, X) == pytest.approx(angle, abs=1e-15)


def test_position_error_is_measured_at_the_part():
    tilted = np.array([np.sin(0.1), 0, np.cos(0.1)])
    at = np.array([0.5, 0.2, 3.0])  # the part's centre; the true axis is z, its nearest point (0, 0, 3)
    assert metrics.position_error(at, Z, np.zeros(3), tilted, np.zeros(3)) == pytest.approx(3 * np.sin(0.1))
    assert metrics.line_to_line(Z, np.zeros(3), tilted, np.zeros(3)) == 0


def test_skew_lines_are_as_far_apart_as_their_planes():
    assert metrics.line_to_line(X, np.array([5.0, 0, 1]), Y, np.array([0, -7.0, -2])) == pytest.approx(3)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("tilt", [0, 1e-12, 9e-7])
def test_parallel_lines_are_measured_point_to_line(sign, tilt):
    b = sign * np.array([np.sin(tilt), 0, np.cos(tilt)])
    assert metrics.line_to_line(Z, np.zeros(3), b, np.array([3.0, 4.0, 0])) == pytest.approx(5, abs=1e-5)


def test_state_error_removes_sign_and_median_offset():
    truth = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    states = -(truth + 0.5)
    states[4] -= 0.25
    assert metrics.state_error(truth, states, -1.0, False) == pytest.approx(0.05)
    assert metrics.state_error(truth, states, -1.0, True) == pytest.approx(0.05)
    assert metrics.state_error(truth, states, 1.0, False) > 0.2


@pytest.mark.parametrize("seed", range(5))
def test_the_circular_offset_is_the_best_there_is(seed):
    rng = np.random.default_rng(seed)
    truth, states = rng.normal(size=9), rng.normal(size=9) * (0.2 if seed % 2 else 3)
    grid = np.linspace(-np.pi, np.pi, 20001)[:, None]
    best = np.abs(metrics.wrap(states - truth - grid)).mean(1).min()
    error = metrics.state_error(truth, states, 1.0, True)
    assert error <= best + 1e-12 and error == pytest.approx(best, abs=1e-3)
    assert metrics.state_error(truth, states + np.pi, 1.0, True) == pytest.approx(error, abs=1e-12)
    assert metrics.state_error(truth, states + 2 * np.pi * rng.integers(-3, 3, 9), 1.0, True) == pytest.approx(error)


def test_miou_counts_what_is_absent_in_both_as_right():
    truth = np.zeros((3, 2, 4), np.uint8)
    answer = truth.copy()
    truth[0, 0], answer[0, 0, :2] = 1, 1  # reference: 2 of 4, moving absent in both
    truth[1, 0], answer[1, 1] = 2, 2  # moving: nothing of 8, reference absent in both
    counts = np.stack([metrics.confusion(t, a) for t, a in zip(truth, answer, strict=True)])
    same, swapped = metrics.miou(counts)
    assert same == pytest.approx((0.5 + 1 + 1 + 0 + 1 + 1) / 6)
    assert swapped == pytest.approx((0 + 0 + 0 + 0 + 1 + 1) / 6)


def random_poses(rng, n):
    return se3.exp_se3(rng.normal(size=(n, 6)))


def test_alignment_does_not_depend_on_where_the_answers_origin_is():
    rng = np.random.default_rng(2)
    truth, centre = random_poses(rng, 12), np.array([0.1, -0.2, 0.3])
    answer = truth @ se3.exp_se3(0.1 * rng.normal(size=(12, 6)))
    far = se3.pose(se3.exp_so3([1.0, 2, 3]), [20.0, -10, 5])
    expected = metrics.align(truth, answer, centre) @ far
    assert np.allclose(metrics.align(truth, answer @ far, centre), expected, atol=1e-9)


def test_pose_error_is_angle_and_shift_of_the_centre():
    rng = np.random.default_rng(3)
    truth, centre = random_poses(rng, 5), np.array([1.0, 2, 3])
    R = se3.exp_so3([0, 0, 0.2])
    about_centre = se3.pose(R, centre - R @ centre)
    assert metrics.pose_error(truth, truth @ about_centre, centre) == pytest.approx((0.2, 0), abs=1e-9)
    assert metrics.pose_error(truth, truth @ se3.pose(np.eye(3), [0, 0.3, 0.4]), centre) == pytest.approx((0, 0.5))


def test_fscore_is_harmonic_and_survives_nothing():
    near, far = np.array([0.1, 0.1, 0.3, 0.3]), np.array([0.1, 0.3, 0.3, 0.3])
    assert metrics.fscore(near, far, 0.2) == pytest.approx(2 * 0.5 * 0.25 / 0.75)
    assert metrics.fscore(near, far, 0.01) == 0
    assert metrics.fscore(near, far, 0.3) == 1


def test_psnr_of_a_known_error():
    truth = np.full((8, 8, 3), 100, np.uint8)
    mask = np.zeros((8, 8), bool)
    mask[2:5, 2:5] = True
    wrong = np.where(mask[..., None], 110, 0).astype(np.uint8)
    assert metrics.psnr(truth, wrong, mask) == pytest.approx(20 * np.log10(25.5))
    assert metrics.psnr(truth, truth, mask) == metrics.PSNR_CAP
    assert metrics.psnr(np.zeros_like(truth), np.full_like(truth, 255), mask) == 0


def test_ssim_is_one_for_equal_pictures_of_any_size_and_falls_with_noise():
    rng = np.random.default_rng(0)
    for shape in ((1, 1), (5, 9), (40, 30)):
        picture = rng.integers(0, 255, (*shape, 3)).astype(np.uint8)
        mask = np.ones(shape, bool)
        assert metrics.ssim(picture, picture, mask) == pytest.approx(1)
    noisy = np.clip(picture + rng.normal(size=picture.shape) * 60, 0, 255).astype(np.uint8)
    assert 0 < metrics.ssim(picture, noisy, mask) < 0.95
    outside = picture.copy()
    mask[:, :10] = False
    outside[:, :10] = 0
    assert metrics.ssim(picture, outside, mask) == pytest.approx(1)


# ---- the surface


def slow_distance(points, corners):
    """Least distance over all triangles, by plane and edges, in plain numpy."""
    best = np.full(len(points), np.inf)
    for a, b, c in corners:
        n = np.cross(b - a, c - a)
        inside = np.ones(len(points), bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= np.cross(q - p, points - p) @ n >= 0
            t = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)[:, None]
            best = np.minimum(best, np.linalg.norm(points - p - t * (q - p), axis=1))
        best = np.where(inside, np.minimum(best, np.abs((points - a) @ n) / np.linalg.norm(n)), best)
    return best


@pytest.mark.parametrize("faces", [1, 2, 5, 300])
def test_distance_is_exact(faces):
    rng = np.random.default_rng(faces)
    corners = rng.normal(size=(faces, 3, 3)) * rng.choice([1e-3, 0.1, 1], (faces, 1, 1))
    corners += rng.normal(size=(faces, 1, 3))
    mesh = Mesh(corners.reshape(-1, 3), np.arange(3 * faces).reshape(-1, 3))
    points = np.concatenate([rng.normal(size=(500, 3)) * 2, corners.reshape(-1, 3), corners.mean(1)])
    assert np.allclose(Surface(mesh).distance(points), slow_distance(points, corners), atol=1e-12)


def test_distance_keeps_its_digits_on_thin_triangles():
    thin = np.array([[[0, 0, 0], [1, 0, 0], [0.5, 1e-8, 0.0]], [[0, 0, 0], [1, 0, 0], [0.3, 0, -1e-10]]])
    mesh = Mesh(thin.reshape(-1, 3), np.arange(6).reshape(-1, 3))
    points = np.array([[0.3, 0, 0.1], [0.77, 0, 0], [-1, 0, 0], [0.5, 2, 0]])
    assert Surface(mesh).distance(points) == pytest.approx([0.1, 0, 1, 2], abs=1e-7)


def test_samples_lie_on_the_surface_in_proportion_to_area():
    a, b = trimesh.creation.box([1, 1, 1]), trimesh.creation.box([2, 2, 2]).apply_translation([5, 0, 0])
    both = trimesh.util.concatenate([a, b])
    surface = Surface(Mesh(both.vertices, both.faces))
    points = surface.sample(20_000, (0, 1))
    assert surface.distance(points).max() < 1e-12
    assert np.mean(points[:, 0] > 2) == pytest.approx(0.8, abs=0.01)
    assert np.mean(points[:1000, 0] > 2) == pytest.approx(0.8, abs=0.05)
    assert np.array_equal(points, surface.sample(20_000, (0, 1)))
    assert not np.array_equal(points, surface.sample(20_000, (0, 2)))


def test_a_surface_without_area_is_empty_and_infinitely_far():
    line = Surface(Mesh(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]])))
    assert line.empty
    assert line.sample(10, (0,)).shape == (0, 3)
    assert np.isinf(line.distance(np.zeros((2, 3)))).all()
    assert np.array_equal(line.distance(np.zeros((2, 3)), np.array([1.0, 2.0])), [1, 2])
