"""The articulated model: what is drawn of it and the way back, its steps, its growth, and what it begins with."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from gaussian_reference import spherical_harmonics

from freeart21 import se3
from freeart21.gaussians import Gaussians
from freeart21.mesh import Mesh
from reconstruct.gaussians import initial
from reconstruct.gaussians.initial import place_discs
from reconstruct.gaussians.model import make_splats
from reconstruct.gaussians.rasteriser import SplatGradients
from reconstruct.settings import GaussianSettings

POSES = se3.pose(se3.exp_so3([[0.3, -0.2, 0.5], [-0.4, 0.6, 0.1]]), [[0.02, -0.01, 1.0], [0.05, 0.03, 1.1]])


def gaussians(n=40, terms=9, seed=0, poses=POSES):
    """Some of one part, some of both, all with their faces to the camera in both poses."""
    rng = np.random.default_rng(seed)
    means = rng.uniform(-0.1, 0.1, (n, 3))
    camera = se3.inverse(poses)[:, :3, 3].mean(0)
    normals = camera - means + rng.normal(0, 0.15, (n, 3))
    light = rng.normal(0, 0.1, (terms, 3))
    light[0] += 1 / 0.28209479
    weights = rng.uniform(0.1, 0.9, n)
    weights[: n // 4], weights[n // 4 : n // 2] = 1, 0
    return Gaussians(
        means,
        rng.normal(size=(n, 4)),
        rng.uniform(0.01, 0.03, (n, 3)),
        rng.uniform(0.3, 0.95, n),
        rng.uniform(0.1, 0.9, (n, 3)),
        weights,
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        light,
    )


# --- what is drawn, and the way back ----------------------------------------------------------------------------------


def test_a_gaussian_is_drawn_under_both_motions_by_its_weight():
    some = gaussians()
    splats, _ = make_splats(some, POSES)
    w, n = some.part_weights, len(some)
    still, moved = np.flatnonzero(w > 0), np.flatnonzero(w < 1)
    assert 0 < len(still) < n and 0 < len(moved) < n and len(still) + len(moved) > n
    index = np.concatenate([still, moved])
    np.testing.assert_array_equal(splats.motion, np.repeat([0, 1], [len(still), len(moved)]))
    np.testing.assert_array_equal(splats.means, some.means[index])
    np.testing.assert_array_equal(splats.quaternions, some.quaternions[index])
    np.testing.assert_array_equal(splats.scales, some.scales[index])
    shares = np.concatenate([w[still], 1 - w[moved]])
    np.testing.assert_allclose(splats.opacities, some.opacities[index] * shares, rtol=1e-6)
    normals = np.einsum("nij,nj->ni", POSES[splats.motion, :3, :3], some.normals[index])
    shades = spherical_harmonics(normals, len(some.light)) @ some.light
    np.testing.assert_allclose(splats.colours, some.colours[index] * shades, atol=1e-5)


def pulls(splats, seed=3):
    """Derivatives by what was drawn, from a hat."""
    rng, m = np.random.default_rng(seed), len(splats)
    names = ("means", "quaternions", "scales", "opacities", "colours")
    own = {name: rng.normal(size=getattr(splats, name).shape).astype(np.float32) for name in names}
    return SplatGradients(
        **own, twists=np.zeros((2, 6)), screen=rng.random(m).astype(np.float32), drawn=rng.random(m) < 0.7
    )


@pytest.mark.parametrize("name", ["means", "quaternions", "scales", "opacities", "colours", "part_weights", "light"])
def test_the_way_back_is_the_difference(name):
    """What is drawn is linear in each of them by itself: differences are exact however wide the step."""
    some = gaussians(12, seed=1)
    splats, back = make_splats(some, POSES)
    d = pulls(splats)
    found = back(d)[name]

    def value(values):
        drawn, _ = make_splats(replace(some, **{name: values}), POSES)
        assert len(drawn) == len(splats), "another choice of splats"
        return sum(
            float((getattr(drawn, k).astype(float) * getattr(d, k)).sum())
            for k in ("means", "quaternions", "scales", "opacities", "colours")
        )

    at = getattr(some, name).astype(float)
    expected, step = np.zeros_like(at), 1e-2 if name != "means" else 1e-3
    for k in np.ndindex(at.shape):
        if name == "part_weights" and at[k] in (0, 1):
            expected[k] = found[k]  # there a copy comes or goes
            continue
        ends = [at.copy(), at.copy()]
        ends[0][k] += step
        ends[1][k] -= step
        expected[k] = (value(ends[0]) - value(ends[1])) / (2 * step)
    assert found.shape == at.shape
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


# --- what it begins with ----------------------------------------------------------------------------------------------


def box(extents, centre, colour):
    made = trimesh.creation.box(extents)
    made.apply_translation(centre)
    return Mesh(made.vertices, made.faces, np.tile(np.uint8([colour]), (len(made.vertices), 1)))


BOXES = (box((0.4, 0.2, 0.1), (0, 0, 0), (200, 40, 90)), box((0.1, 0.1, 0.02), (0, 0.3, 0), (20, 140, 250)))


def test_discs_lie_on_the_surfaces():
    settings, spacing = GaussianSettings(), 0.01
    found = place_discs(BOXES, spacing / initial.SPACING, settings, np.random.default_rng(9))
    areas = [mesh.areas().sum() for mesh in BOXES]
    counts = [round(area / spacing**2) for area in areas]
    second = found.weight_logits < 0
    assert [int((~second).sum()), int(second.sum())] == counts
    some = found.gaussians()
    np.testing.assert_allclose(
        some.part_weights, np.where(second, 1 - initial.PART_WEIGHT, initial.PART_WEIGHT), rtol=1e-4
    )
    np.testing.assert_allclose(some.opacities, initial.OPACITY, rtol=1e-5)
    radius = initial.RADIUS * spacing
    np.testing.assert_allclose(
        some.scales, np.tile([radius, radius, initial.THICKNESS * radius], (len(some), 1)), rtol=1e-5
    )
    for part, (mesh, colour) in enumerate(zip(BOXES, ((200, 40, 90), (20, 140, 250)), strict=True)):
        mine = second == (part == 1)
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        _, distance, face = trimesh.proximity.closest_point(solid, some.means[mine])
        assert distance.max() < 1e-6
        outward = some.means[mine] - mesh.vertices.mean(0)
        assert (np.einsum("nd,nd->n", outward, some.normals[mine]) > 0).all()
        np.testing.assert_allclose(some.colours[mine], np.tile(np.float32(colour) / 255, (mine.sum(), 1)), atol=1e-5)
        each = np.bincount(face, minlength=len(mesh.faces))
        assert np.abs(each - mesh.areas() / spacing**2).max() < 3, "as many on each face as its area asks for"
    assert len(found.light) == settings.light_terms and not found.light[1:].any()
    splats, _ = make_splats(some, np.stack([se3.pose(np.eye(3), [0, 0, 2.0])] * 2))
    np.testing.assert_allclose(splats.colours.max(0), np.float32([200, 140, 250]) / 255, rtol=1e-5)
