"""The rasteriser on a CPU draws what a loop over pixels draws, and its derivatives are that loop's differences."""

from dataclasses import fields, replace

import gaussian_reference as reference
import numpy as np
import pytest
from gaussian_scenes import (
    GRADIENT_SCENES,
    SCENES,
    SMALL,
    WINDOW,
    at,
    behind,
    check_gradients,
    check_picture,
    poses,
    splats,
)
from scipy.spatial.transform import Rotation

from freeart21 import se3
from reconstruct import kernels
from reconstruct.gaussians import numba_backend
from reconstruct.gaussians.rasteriser import Lens, Splats


@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_the_reference_s(name):
    check_picture(numba_backend.rasterise, *SCENES[name]())


def test_no_gaussian_at_all():
    none = replace(splats(), **{f.name: getattr(splats(), f.name)[:0] for f in fields(Splats)})
    picture, pull = numba_backend.rasterise(none, poses(), WINDOW)
    assert all(not getattr(picture, f.name).any() for f in fields(picture))
    found = pull(np.ones_like(picture.colour), np.ones_like(picture.depth), np.ones_like(picture.alpha))
    assert found.means.shape == (0, 3) and found.twists.shape == (2, 6) and not found.twists.any()


@pytest.mark.parametrize("by", [("colour",), ("depth",), ("alpha",), ("colour", "depth", "alpha")])
def test_gradients_are_the_reference_s_differences(by):
    check_gradients(numba_backend.rasterise, splats(8, 20), poses(), SMALL, by=by)


@pytest.mark.parametrize("name", GRADIENT_SCENES)
def test_gradients_of_other_scenes(name):
    check_gradients(numba_backend.rasterise, *GRADIENT_SCENES[name]())


def test_hundreds_in_the_same_tile_change_nothing_elsewhere():
    """What stands before it in the same tile, but not before it in the picture."""
    few = splats(5, 28, (0.005, 0.02), (0.04, 0.08, 0.05))
    few = replace(few, means=few.means - np.float32([0.06, 0, 0]), motion=np.zeros(5, np.uint8))
    crowd = splats(700, 29, (0.002, 0.003), (0.01, 0.1, 0.01))
    crowd = replace(crowd, means=crowd.means + np.float32([0.06, 0, -0.1]), motion=np.zeros(700, np.uint8))
    both = Splats(*(np.concatenate([getattr(crowd, f.name), getattr(few, f.name)]) for f in fields(Splats)))
    (alone, pull_alone), (crowded, pull) = (numba_backend.rasterise(s, at(0.5), WINDOW) for s in (few, both))
    left = np.s_[:, :23]
    assert alone.alpha[left].max() > 0.5 and np.array_equal(alone.alpha[left], crowded.alpha[left])
    rng = np.random.default_rng(30)
    weights = [rng.normal(size=s).astype(np.float32) for s in ((29, 37, 3), (29, 37), (29, 37))]
    for w in weights:
        w[:, 23:] = 0
    expected, found = pull_alone(*weights), pull(*weights)
    for name in ("means", "quaternions", "scales", "opacities", "colours", "screen"):
        value = getattr(expected, name)
        assert np.abs(getattr(found, name)[700:] - value).max() < 2e-5 * np.abs(value).max(), name


def test_what_is_cut_does_not_pull():
    """A Gaussian that is opaque at every pixel it covers there has an opacity that changes nothing."""
    one = replace(splats(1, size=(0.5, 0.5)), opacities=np.array([1.0], np.float32), means=np.zeros((1, 3), np.float32))
    lens = Lens(500.0, 500.0, 1.5, 1.5, 3, 3)
    picture, pull = numba_backend.rasterise(one, at(0.5), lens)
    assert np.allclose(picture.alpha, 0.999, atol=1e-6)
    found = pull(np.ones((3, 3, 3), np.float32), np.ones((3, 3), np.float32), np.ones((3, 3), np.float32))
    assert not found.opacities.any() and not found.scales.any() and found.colours.min() > 8


def test_what_was_drawn_is_said():
    some, Ts, lens = SCENES["off the window"]()
    _, pull = numba_backend.rasterise(some, Ts, lens)
    drawn = pull(np.ones((29, 37, 3), np.float32), np.ones((29, 37), np.float32), np.ones((29, 37), np.float32)).drawn
    blended = np.unique([g for _, _, g in reference.draw(some, Ts, lens).blended])
    assert drawn[blended].all() and len(blended) < drawn.sum() + 1 < len(drawn)
    some, Ts, lens = behind()
    _, pull = numba_backend.rasterise(some, Ts, lens)
    found = pull(np.ones((29, 37, 3), np.float32), np.ones((29, 37), np.float32), np.ones((29, 37), np.float32))
    assert not found.drawn[:6].any() and not found.means[:6].any() and not found.screen[:6].any()


def test_the_same_bytes_again_and_with_other_threads(monkeypatch):
    many, lens = splats(1500, 30), Lens(200.0, 200.0, 60.0, 50.0, 123, 101)
    rng = np.random.default_rng(31)
    weights = [rng.normal(size=s).astype(np.float32) for s in ((101, 123, 3), (101, 123), (101, 123))]

    def result():
        picture, pull = numba_backend.rasterise(many, poses(), lens)
        return [getattr(x, f.name).tobytes() for x in (picture, pull(*weights)) for f in fields(x)]

    once = result()
    assert result() == once
    for threads in (1, 3, 7):
        monkeypatch.setattr(kernels, "_THREADS", threads)
        assert result() == once, threads


@pytest.mark.parametrize("tilt, most", [(0, 1e-3), (40, 0.05), (65, 0.3)])
def test_depth_of_discs_is_that_of_their_plane(tilt, most):
    """Means, blended front to back, come out nearer the more the plane is tilted: .59 pixels at 40, 1.5 at 65 degrees.

    What is left is of THIN.
    """
    rng, pixel = np.random.default_rng(0), 0.5 / 300
    R = Rotation.from_euler("x", 180 - tilt, degrees=True)
    places = np.stack([*rng.uniform(-0.08, 0.08, (2, 9000)), np.zeros(9000)], 1)
    one = np.ones(len(places), np.float32)
    discs = Splats(
        R.apply(places).astype(np.float32),
        np.tile(np.roll(R.as_quat(), 1), (len(places), 1)).astype(np.float32),
        np.tile(pixel * np.array([0.7, 0.7, 0.07]), (len(places), 1)).astype(np.float32),
        0.7 * one,
        np.ones((len(places), 3), np.float32),
        np.zeros(len(places), np.uint8),
    )
    pose = se3.pose(np.eye(3), [0, 0, 0.5])
    picture, _ = numba_backend.rasterise(discs, np.stack([pose, pose]), Lens(300.0, 300.0, 16.0, 16.0, 32, 32))
    y, x = (np.mgrid[:32, :32] + 0.5 - 16) / 300
    normal = R.apply([0, 0, 1])
    plane = 0.5 * normal[2] / (normal[0] * x + normal[1] * y + normal[2])
    off = (picture.depth / picture.alpha - plane)[picture.alpha > 0.9] / pixel
    assert len(off) > 500 and abs(off.mean()) < most
