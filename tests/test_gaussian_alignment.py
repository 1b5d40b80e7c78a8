"""Gauss-Newton over the pixels: steps go home, and what the model's own surface would take back is left out of them."""

import numpy as np
import pytest
import trimesh
from scipy.ndimage import map_coordinates

from freeart21 import se3
from freeart21.mesh import Mesh
from reconstruct.gaussians import numba_backend
from reconstruct.gaussians.alignment import Scales, alignment_terms
from reconstruct.gaussians.initial import SPACING, place_discs
from reconstruct.gaussians.losses import Target
from reconstruct.gaussians.model import make_splats
from reconstruct.gaussians.rasteriser import Lens
from reconstruct.settings import GaussianSettings

LENS = Lens(170.0, 170.0, 60.0, 45.0, 120, 90)
SCALES = Scales(0.01, 0.002, 0.3)
CELL = 0.01
T = se3.pose(se3.exp_so3([0.5, 0.5, 0.1]), [0, 0, 1.0])
Ts = np.stack([T, T @ se3.pose(se3.exp_so3([0, -0.5, 0]), [0, 0, 0])])
"""The parts' true poses."""


def textured(extents, centre, seed):
    """A box with smooth colours, some 0.03 wide."""
    made = trimesh.creation.box(extents)
    made.apply_translation(centre)
    for _ in range(5):
        made = made.subdivide()
    texture = np.random.default_rng(seed).uniform(0.1, 1, (3, 12, 12, 12))
    at = (made.vertices / 0.03 % 12).T
    colours = np.stack([map_coordinates(c, at, order=1, mode="grid-wrap") for c in texture], 1)
    return Mesh(made.vertices, made.faces, (255 * colours).astype(np.uint8))


@pytest.fixture(scope="module")
def model():
    """Discs of one part each."""
    meshes = textured((0.3, 0.2, 0.06), (0, 0, 0), 0), textured((0.12, 0.18, 0.06), (0.0, 0.0, 0.12), 1)
    return place_discs(meshes, 0.004 / SPACING, GaussianSettings(), np.random.default_rng(0)).gaussians(blended=False)


def render(model, poses):
    splats, _ = make_splats(model, poses)
    return numba_backend.rasterise(splats, poses, LENS)[0]


def target_of(picture):
    mask = picture.alpha > 0.5
    safe = np.maximum(picture.alpha, 0.5)
    depth = np.where(mask, picture.depth / safe, 0).astype(np.float32)
    colour = picture.colour + (1 - picture.alpha)[..., None]
    return Target(colour, depth, mask, np.zeros_like(depth))


def off_by(poses, twist, part):
    moved = poses.copy()
    moved[part] = se3.exp_se3(twist) @ moved[part]
    return moved


def step(model, target, poses):
    """The poses after one Gauss-Newton step of both parts, the model as it is."""
    terms = alignment_terms(render(model, poses), target, LENS, poses, SCALES, CELL)
    twists = np.stack([-np.linalg.solve(terms.H[k], terms.g[k]) for k in range(2)])
    return se3.exp_se3(twists) @ poses


def away(poses):
    """How far the points of the parts are from where they belong, metres: (2,)."""
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0, 0.1)])
    found = [se3.transform(a, corners) - se3.transform(b, corners) for a, b in zip(poses, Ts, strict=True)]
    return np.linalg.norm(found, axis=2).max(1)


TWISTS = {
    "right": [0.003, 0, 0, 0, 0, 0],
    "down": [0, -0.003, 0, 0, 0, 0],
    "away": [0, 0, 0.006, 0, 0, 0],
    "roll": [0, -0.008, 0, 0.008, 0, 0],
    "yaw": [-0.015, 0, 0, 0, 0.015, 0],
    "in the picture": [0, 0, 0, 0, 0, 0.03],
    "all": [0.002, -0.004, 0.002, 0.004, -0.003, 0.006],
}


SMALL = ("right", "down", "away", "in the picture")  # 20 pixels wide, half before the other part: no more is sure


@pytest.mark.parametrize("name, part", [*((name, 0) for name in TWISTS), *((name, 1) for name in SMALL)])
def test_steps_bring_a_part_back(model, name, part):
    target = target_of(render(model, Ts))
    poses = off_by(Ts, TWISTS[name], part)
    begin = away(poses)
    assert begin[part] > 0.0025 and begin[1 - part] == 0
    poses = step(model, target, poses)
    for _ in range(5):
        poses = step(model, target, poses)
    assert away(poses)[part] < max(0.15 * begin[part], 0.003)  # half a pixel


def test_at_the_truth_hardly_anything_pulls(model):
    """A silhouette pulls the small part by up to a pixel, 6 mm here: blending has a longer tail outside than inside. A
    model that has learned its masks has made up for that."""
    target = target_of(render(model, Ts))
    terms = alignment_terms(render(model, Ts), target, LENS, Ts, SCALES, CELL)
    assert away(step(model, target, Ts))[0] < 1e-4 and away(step(model, target, Ts))[1] < 0.006
    assert terms.count > 3000 and terms.spread[0] < 1e-3 and terms.spread[1] < 1e-5
    off = alignment_terms(render(model, off_by(Ts, TWISTS["all"], 0)), target, LENS, Ts, SCALES, CELL)
    assert off.cost > 5 * terms.cost
