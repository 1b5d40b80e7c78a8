"""The articulated model: what is drawn of it and the way back, its steps, its growth, and what it begins with."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from gaussian_reference import spherical_harmonics

from freeart21 import se3
from freeart21.gaussians import LIGHT_TERMS, Gaussians
from freeart21.mesh import Mesh
from reconstruct.gaussians import adam, density, initial, model
from reconstruct.gaussians.adam import Adam
from reconstruct.gaussians.density import densify_and_prune
from reconstruct.gaussians.initial import place_discs
from reconstruct.gaussians.model import Parameters, logit, make_splats
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


def parameters(n=30, seed=0, terms=4):
    rng = np.random.default_rng(seed)
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, 3), (n,), (terms, 3))
    return Parameters(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))


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


def test_copies_too_faint_to_matter_are_left_out():
    some = replace(gaussians(4), opacities=np.full(4, 0.5), part_weights=np.array([1, 0.97, 0.95, 0]))
    splats, _ = make_splats(some, POSES)
    assert 0.5 * (1 - 0.97) < model.FAINT_COPY < 0.5 * (1 - 0.95)
    np.testing.assert_array_equal(splats.motion, [0, 0, 0, 1, 1])
    np.testing.assert_array_equal(splats.means, some.means[[0, 1, 2, 2, 3]])


def test_discs_that_are_turned_away_are_left_out():
    angles = np.radians([0, 60, 89, 94, 97, 120, 180])
    n = len(angles)
    normals = np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], 1)
    some = replace(gaussians(n), means=np.zeros((n, 3)), normals=normals, part_weights=np.ones(n))
    ahead = np.stack([se3.pose(np.eye(3), [0, 0, 2.0])] * 2)
    splats, _ = make_splats(some, ahead)
    np.testing.assert_array_equal(splats.opacities, some.opacities[:4])
    # the part's own pose counts: turned round, the others show
    turned = np.stack([se3.pose(se3.exp_so3([0, np.pi, 0]), [0, 0, 2.0]), ahead[1]])
    np.testing.assert_array_equal(make_splats(some, turned)[0].opacities, some.opacities[2:])


def test_light_is_fixed_in_the_frame_it_is_given():
    some = gaussians()
    elsewhere = se3.pose(se3.exp_so3([0.0, 0.2, 0.0]), np.zeros(3)) @ POSES
    here, _ = make_splats(some, elsewhere, POSES)
    splats, _ = make_splats(some, POSES)
    assert len(here) == len(splats)
    np.testing.assert_array_equal(here.colours, splats.colours)
    assert np.abs(make_splats(some, elsewhere)[0].colours - splats.colours).max() > 0.01


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


def test_a_frame_that_shows_none_of_them_has_a_way_back():
    some = gaussians()
    splats, back = make_splats(replace(some, normals=-some.normals), POSES)
    assert len(splats) == 0
    found = back(pulls(splats))
    for name in ("means", "quaternions", "opacities", "part_weights", "light"):
        assert found[name].shape == getattr(some, name).shape and not found[name].any()


@pytest.mark.parametrize("terms", LIGHT_TERMS)
def test_harmonics_are_those_of_the_light_layer(terms):
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = np.full((50, terms), np.nan, np.float32)
    for direction, row in zip(directions.astype(np.float32), found, strict=True):
        model._harmonics(*direction, row)
    np.testing.assert_allclose(found, spherical_harmonics(directions, terms), atol=2e-6)


def test_what_parameters_stand_for():
    some = parameters()
    found = some.gaussians()
    np.testing.assert_allclose(np.linalg.norm(found.quaternions, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(found.normals, se3.rotation_from_wxyz(some.quaternions)[:, :, 2], atol=1e-6)
    np.testing.assert_allclose(found.scales, np.exp(some.log_scales), rtol=1e-6)
    np.testing.assert_allclose(logit(found.opacities), some.opacity_logits, rtol=1e-3, atol=1e-5)
    assert found.colours.min() == 0 and found.colours.max() == 1
    assert len(np.unique(found.part_weights)) == 30
    hard = some.gaussians(blended=False)
    np.testing.assert_array_equal(hard.part_weights, some.weight_logits > 0)
    splats, _ = make_splats(hard, POSES)
    assert 0 < len(splats) <= 30 and np.isin(splats.opacities, hard.opacities).all()


# --- Adam -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [30, 5000])
def test_steps_are_adam_s(n):
    some, rng = parameters(n), np.random.default_rng(5)
    optimiser, rates = Adam(some), {name: 0.01 * (k + 1) for k, name in enumerate(some.arrays())}
    own = {name: values.astype(float) for name, values in some.arrays().items()}
    first = {name: np.zeros_like(values) for name, values in own.items()}
    second = {name: np.zeros_like(values) for name, values in own.items()}
    steps = {name: np.zeros(len(values)) for name, values in own.items()}
    for _ in range(12):
        gradient = {name: rng.normal(size=v.shape).astype(np.float32) for name, v in some.arrays().items()}
        shown = rng.random(n) < 0.6
        shown[0] = False
        optimiser.step(some, gradient, shown, rates)
        for name, g in gradient.items():
            rows = np.ones(len(g), bool) if name == "light" else shown
            steps[name] += rows
            t = steps[name][rows].reshape(-1, *[1] * (g.ndim - 1))
            first[name][rows] = 0.9 * first[name][rows] + 0.1 * g[rows]
            second[name][rows] = 0.999 * second[name][rows] + 0.001 * g[rows].astype(float) ** 2
            over = np.sqrt(second[name][rows] / (1 - 0.999**t)) + adam.EPSILON
            own[name][rows] -= rates[name] * first[name][rows] / (1 - 0.9**t) / over
    for name, values in some.arrays().items():
        np.testing.assert_allclose(values, own[name], rtol=1e-3, atol=2e-5, err_msg=name)
        np.testing.assert_allclose(getattr(optimiser.first, name), first[name], rtol=1e-4, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(getattr(optimiser.second, name), second[name], rtol=1e-4, atol=1e-6, err_msg=name)
    begin = parameters(n)
    np.testing.assert_array_equal(some.means[0], begin.means[0])
    assert some.opacity_logits[0] == begin.opacity_logits[0] and not optimiser.first.means[0].any()
    assert (some.light != begin.light).all()


def test_moments_go_with_their_gaussians():
    some, rng = parameters(), np.random.default_rng(7)
    optimiser, rates = Adam(some), dict.fromkeys(some.arrays(), 0.1)
    for _ in range(3):
        gradient = {name: rng.normal(size=v.shape).astype(np.float32) for name, v in some.arrays().items()}
        optimiser.step(some, gradient, rng.random(30) < 0.8, rates)
    old, counts = optimiser.second.arrays(), optimiser.steps.copy()
    which, fresh = np.array([7, 3, 3, 29]), np.array([False, False, True, False])
    optimiser.select(which, fresh)
    assert counts[which].all()
    np.testing.assert_array_equal(optimiser.steps, np.where(fresh, 0, counts[which]))
    for name, values in optimiser.second.arrays().items():
        if name == "light":
            np.testing.assert_array_equal(values, old[name])
        else:
            np.testing.assert_array_equal(values[~fresh], old[name][which[~fresh]])
            assert not values[fresh].any() and values[~fresh].all()


# --- more of them, and fewer ------------------------------------------------------------------------------------------


def growing(n=200, seed=8):
    some = parameters(n, seed)
    some.opacity_logits[:] = 1
    return some, np.random.default_rng(seed).random(n), np.ones(n)


def test_those_that_are_pulled_most_are_split():
    some, pull, looks = growing()
    new, which, fresh = densify_and_prune(some, pull, looks, 1000)
    chosen = np.sort(np.argsort(-pull)[: round(density.SPLIT * 200)])
    assert len(new) == len(which) == 200 + len(chosen)
    np.testing.assert_array_equal(np.unique(which[fresh]), chosen)
    np.testing.assert_array_equal(np.bincount(which, minlength=200)[chosen], 2)
    for g in chosen:
        pair = np.flatnonzero(which == g)
        longest = np.argmax(some.log_scales[g])
        axis, length = se3.rotation_from_wxyz(some.quaternions[g])[:, longest], np.exp(some.log_scales[g, longest])
        np.testing.assert_allclose(new.means[pair].mean(0), some.means[g], atol=1e-5)
        np.testing.assert_allclose(np.abs((new.means[pair[1]] - new.means[pair[0]]) @ axis), length, rtol=1e-4)
        np.testing.assert_allclose(np.linalg.norm(new.means[pair[1]] - new.means[pair[0]]), length, rtol=1e-4)
        np.testing.assert_allclose(new.log_scales[pair], [some.log_scales[g] - np.log(density.SHRUNK)] * 2, rtol=1e-5)
    others = ~fresh
    for name in ("means", "log_scales", "colours", "weight_logits"):
        np.testing.assert_array_equal(getattr(new, name)[others], getattr(some, name)[which[others]])
    np.testing.assert_array_equal(new.light, some.light)


@pytest.mark.parametrize("most, expected", [(205, 205), (200, 200), (150, 200)])
def test_there_are_never_more_than_allowed_by_growth(most, expected):
    new, _, fresh = densify_and_prune(*growing(), most)
    assert len(new) == expected and fresh.sum() == 2 * (expected - 200)


def test_faint_and_unseen_ones_go():
    some, pull, looks = growing()
    some.opacity_logits[:20] = logit(np.float32([density.FAINT - 0.01]))
    some.opacity_logits[20:40] = logit(np.float32([density.FAINT + 0.01]))
    looks[180:] = 0
    pull[:20], pull[180:] = 10, 20  # and are not split either
    new, which, fresh = densify_and_prune(some, pull, looks, 200)
    np.testing.assert_array_equal(np.unique(which), np.arange(20, 180))
    assert len(new) == 160 + round(density.SPLIT * 160)
    assert fresh.sum() == 2 * round(density.SPLIT * 160)


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


def test_there_are_fewer_discs_where_there_would_be_too_many():
    many = place_discs(BOXES, 0.001, replace(GaussianSettings(), begin=1000), np.random.default_rng(0))
    assert abs(len(many) - 1000) <= 1
    area = sum(mesh.areas().sum() for mesh in BOXES)
    np.testing.assert_allclose(np.exp(many.log_scales[:, 0]), initial.RADIUS * np.sqrt(area / 1000), rtol=1e-5)


def test_a_part_that_was_never_seen_has_no_discs():
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    found = place_discs((BOXES[0], nothing), 0.01 / initial.SPACING, GaussianSettings(), np.random.default_rng(0))
    assert len(found) == round(BOXES[0].areas().sum() / 0.01**2) and (found.weight_logits > 0).all()
    found = place_discs((nothing, BOXES[1]), 0.01 / initial.SPACING, GaussianSettings(), np.random.default_rng(0))
    assert len(found) == round(BOXES[1].areas().sum() / 0.01**2) and (found.weight_logits < 0).all()
