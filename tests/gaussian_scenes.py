"""Scenes of Gaussians, and the checks that every rasteriser has to pass on them."""

from dataclasses import fields, replace

import gaussian_reference as reference
import numpy as np

from freeart21 import se3
from reconstruct.gaussians.rasteriser import FAINTEST, Lens, Splats

WINDOW = Lens(70.0, 72.0, 17.3, 14.6, 37, 29)
SMALL = Lens(40.0, 42.0, 9.2, 7.9, 19, 15)


def splats(n=12, seed=0, size=(0.004, 0.03), spread=(0.12, 0.1, 0.05), thick=(0.1, 0.9)):
    """Gaussians about the origin, sizes log-uniform, under both motions."""
    rng = np.random.default_rng(seed)
    return Splats(
        (rng.uniform(-1, 1, (n, 3)) * spread).astype(np.float32),
        rng.normal(size=(n, 4)).astype(np.float32),
        np.exp(rng.uniform(*np.log(size), (n, 3))).astype(np.float32),
        rng.uniform(*thick, n).astype(np.float32),
        rng.uniform(0, 1, (n, 3)).astype(np.float32),
        rng.integers(0, 2, n).astype(np.uint8),
    )


def poses(distance=0.5, seed=1):
    rng = np.random.default_rng(seed)
    return se3.pose(se3.exp_so3(rng.normal(0, 0.5, (2, 3))), np.array([0, 0, distance]) + rng.normal(0, 0.01, (2, 3)))


def behind():
    """Some behind the camera, some at its very centre, some before it."""
    some = splats(12, 4)
    means = some.means.copy()
    means[:4, 2], means[4:6, 2], means[6:, 2] = -0.5, 0.004, 0.5
    return replace(some, means=means), np.stack([np.eye(4)] * 2), WINDOW


def edge_on():
    """Discs seen along their planes, and needles that point at the camera."""
    some = splats(12, 5)
    scales = np.full((12, 3), 0.02, np.float32)
    scales[:6, 0] = 2e-5  # flat along x: the camera looks along the plane
    scales[6:, :2] = 2e-5
    quaternions = np.tile(np.array([1, 0, 0, 0], np.float32), (12, 1))
    return replace(some, scales=scales, quaternions=quaternions), at(0.5), WINDOW


def at(distance):
    return np.stack([se3.pose(np.eye(3), [0, 0, distance])] * 2)


def _window(width, height):
    return Lens(80.0, 80.0, 0.4 * width, 0.6 * height, width, height)


SCENES = {
    "plain": lambda: (splats(), poses(), WINDOW),
    "larger than the window": lambda: (splats(8, 2, (0.2, 2.0)), poses(), WINDOW),
    "smaller than a pixel": lambda: (splats(30, 3, (1e-6, 1e-4), thick=(0.5, 1)), poses(), WINDOW),
    "many in one place": lambda: (splats(60, 6, spread=(0.02, 0.02, 0.02)), poses(), WINDOW),
    "opaque": lambda: (splats(40, 7, (0.02, 0.1), thick=(0.97, 1)), poses(), WINDOW),
    "behind the camera": behind,
    "off the window": lambda: (splats(40, 8, spread=(0.4, 0.4, 0.05)), poses(), WINDOW),
    "edge on": edge_on,
    "needles across": lambda: (
        replace(splats(10, 9), scales=np.tile(np.array([0.15, 5e-5, 5e-5], np.float32), (10, 1))),
        poses(),
        WINDOW,
    ),
    "a crop far from the axis": lambda: (
        splats(),
        se3.exp_se3([0.5, -0.4, 0, 0, 0, 0]) @ poses(),
        replace(WINDOW, cx=-55.0, cy=75.0),
    ),
    "a tile": lambda: (splats(), poses(), _window(32, 32)),
    "a tile and a pixel": lambda: (splats(), poses(), _window(33, 33)),
    "one pixel": lambda: (splats(seed=10, size=(0.02, 0.1)), poses(), Lens(80.0, 80.0, 0.5, 0.5, 1, 1)),
    "a strip": lambda: (splats(), poses(), _window(97, 3)),
    "hundreds behind opaque ones": lambda: (
        splats(700, 11, (0.02, 0.1), (0.1, 0.1, 0.1), (0.3, 0.99)),
        poses(),
        Lens(20.0, 20.0, 3.5, 2.5, 7, 5),
    ),
    "one motion": lambda: (replace(splats(), motion=np.ones(12, np.uint8)), poses(), WINDOW),
}


GRADIENT_SCENES = {
    "other ones": lambda: (splats(8, 21), poses(seed=22), SMALL),
    "larger than the window": lambda: (splats(6, 23, (0.1, 0.5)), poses(), SMALL),
    "smaller than a pixel": lambda: (splats(10, 24, (2e-3, 8e-3)), poses(), SMALL),
    "many in one place": lambda: (splats(11, 25, (0.01, 0.05), (0.02, 0.02, 0.05), (0.7, 0.99)), poses(), SMALL),
    "edge on": lambda: (
        replace(edge_on()[0], motion=np.arange(12, dtype=np.uint8) % 2),
        at(0.5),
        Lens(45.0, 45.0, 9.3, 7.1, 19, 15),
    ),
    "a crop far from the axis": lambda: (
        splats(8, 26),
        se3.exp_se3([0.4, -0.3, 0, 0, 0, 0]) @ poses(),
        Lens(40.0, 42.0, -23.0, 32.0, 19, 15),
    ),
    "across tiles": lambda: (splats(5, 27, (0.02, 0.1)), poses(), Lens(150.0, 150.0, 16.0, 2.0, 67, 4)),
}


def check_picture(rasterise, splats, poses, lens, clamp=False):
    """Where no decision is a matter of rounding: to a few roundings; elsewhere within what such decisions change."""
    picture, _ = rasterise(splats, poses, lens)
    true = reference.draw(splats, poses, lens, clamp=clamp)
    sure = true.margin > 1e-4
    assert sure.mean() > 0.9 and true.picture.alpha.max() > 0.2, "a scene that shows nothing"
    for field in fields(picture):
        found, expected = getattr(picture, field.name), getattr(true.picture, field.name)
        assert found.dtype == np.float32 and found.shape == expected.shape
        assert np.abs(found - expected)[sure].max() < 2e-5, field.name
        assert np.abs(found - expected).max() < 2 * FAINTEST, field.name


def check_gradients(rasterise, splats, poses, lens, by=("colour", "depth", "alpha"), clamp=False):
    """Each kind to a few roundings of its largest."""
    rng = np.random.default_rng(0)
    shape = (lens.height, lens.width)
    given = {"colour": rng.normal(size=(*shape, 3)), "depth": rng.normal(size=shape), "alpha": rng.normal(size=shape)}
    weights = [given[name].astype(np.float32) if name in by else np.zeros_like(given[name]) for name in given]
    expected = reference.derivatives(splats, poses, lens, *weights, clamp=clamp)
    _, pull = rasterise(splats, poses, lens)
    found = pull(*(w.astype(np.float32) for w in weights))
    for name, value in expected.items():
        got = getattr(found, name)
        assert got.shape == value.shape
        largest = np.abs(value).max()
        if name == "colours" and "colour" not in by:
            assert largest == 0 and not got.any()
            continue
        assert largest > 0, f"nothing depends on the {name}"
        assert np.abs(got - value).max() < 2e-5 * largest, name
