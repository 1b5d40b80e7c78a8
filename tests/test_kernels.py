"""Costs of single pixels under motions, and the graph of similar neighbours."""

import numpy as np
import pytest

from reconstruct import kernels

SIGMA = 0.001


def cost_before_a_wall(normal, distance):
    """Cost of a point with this normal, `distance` (m) in front of a wall that fills the other frame."""
    h = w = 9
    pixels = np.zeros((2, h, w, 12), np.float32)
    y, x = np.mgrid[:h, :w]
    pixels[1, ..., kernels.POINT : kernels.POINT + 3] = np.stack([(x - 4) / 100, (y - 4) / 100, np.ones((h, w))], -1)
    pixels[..., kernels.NORMAL : kernels.NORMAL + 3] = 0, 0, -1
    pixels[0, 4, 4, kernels.POINT : kernels.POINT + 3] = 0, 0, 1 - distance
    pixels[0, 4, 4, kernels.NORMAL : kernels.NORMAL + 3] = np.divide(normal, np.linalg.norm(normal))
    centre, found = np.full(2, 4.0), np.zeros((1, 1, 1))
    arguments = 0, np.array([1]), np.eye(4)[None, None], np.array([[4, 4]]), pixels.reshape(-1, 12), h, w
    kernels.pixel_costs(
        0, 1, *arguments, np.zeros(1, np.float32), 0.0, 100.0, 100.0, centre, centre, SIGMA, 3.0, 6.0, found
    )
    return float(found[0, 0, 0])


@pytest.mark.parametrize(
    ("normal", "cost"),
    [((0, 0, -1), 3.6), ((0, 1, 0), 0.5), ((0, 1, 0.05), 0.5), ((0, 1, -0.05), 0.5), ((0, 1, 0.5), 6.0)],
)
def test_a_point_in_front_of_a_surface_is_contradicted(normal, cost):
    assert cost_before_a_wall(normal, 20 * SIGMA) == pytest.approx(cost)


def test_a_point_behind_a_surface_is_occluded():
    assert cost_before_a_wall((0, 0, -1), -20 * SIGMA) == pytest.approx(kernels.HIDDEN)
    assert cost_before_a_wall((0, 1, 0.5), -20 * SIGMA) == pytest.approx(0.5)


def held_across(ramp):
    """Smallest edge weight between neighbours along a row that is dark, then a `ramp`, then bright."""
    row = np.concatenate([np.zeros(8), ramp, np.full(8, 24.0)])
    h, w = 1, len(row)
    points = np.stack([np.arange(w) / 1000.0, np.zeros(w), np.ones(w)], -1)[None].astype(np.float32)
    normals = np.broadcast_to(np.array([0, 0, -1], np.float32), (h, w, 3)).copy()
    features = np.stack([row, 0 * row, 0 * row], -1)[None].astype(np.float32)
    weights = kernels.neighbours(np.ones((h, w), bool), points, normals, features, 0.1, 0.001)
    return weights[1, 0, :-1].min()


def test_an_image_edge_separates_neighbours():
    assert held_across(np.full(3, 0.0)) == 0, "no ramp: a step"
    assert held_across(np.array([8.0, 16.0])) < 0.02, "next pixels differ by a third of it"
    assert held_across(np.linspace(0, 24, 40)) > 0.9, "shading is no edge"


def test_neighbours_are_summed_both_ways():
    rng, (h, w) = np.random.default_rng(0), (9, 8)
    valid = rng.random((h, w)) < 0.8
    flat = np.broadcast_to(np.array([0, 0, 1], np.float32), (h, w, 3)).copy()
    features = rng.normal(size=(h, w, 3)).astype(np.float32)
    weights = kernels.neighbours(valid, flat, -flat, features, 0.1, 0.001)
    values, expected = rng.random((h, w)), np.zeros((h, w))
    for (q, y, x), weight in np.ndenumerate(weights):
        yy, xx = (y + kernels.STEPS[q // 2], x) if q % 2 == 0 else (y, x + kernels.STEPS[q // 2])
        if yy < h and xx < w:
            assert (weight > 0) == (valid[y, x] and valid[yy, xx])
            expected[y, x] += weight * values[yy, xx]
            expected[yy, xx] += weight * values[y, x]
        else:
            assert weight == 0
    sums = kernels.padded(np.zeros((h, w)))
    kernels.add_neighbours(sums, kernels.padded(values), kernels.padded_weights(weights), w, 1.0)
    np.testing.assert_allclose(sums[kernels.padded(np.ones((h, w))) > 0], expected.ravel(), rtol=1e-12)
