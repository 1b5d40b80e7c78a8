"""The rasteriser on a CPU draws what a loop over pixels draws, and its derivatives are that loop's differences."""

from dataclasses import fields

import numpy as np
import pytest
from gaussian_scenes import (
    GRADIENT_SCENES,
    SCENES,
    SMALL,
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


@pytest.mark.parametrize("by", [("colour",), ("depth",), ("alpha",), ("colour", "depth", "alpha")])
def test_gradients_are_the_reference_s_differences(by):
    check_gradients(numba_backend.rasterise, splats(8, 20), poses(), SMALL, by=by)


@pytest.mark.parametrize("name", GRADIENT_SCENES)
def test_gradients_of_other_scenes(name):
    check_gradients(numba_backend.rasterise, *GRADIENT_SCENES[name]())


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
