"""Windows of frames: the same rays as the recording's, and no depth that is not believed."""

import types

import numpy as np
import pytest

from freeart21.camera import Camera
from freeart21.recording import Frame, Recording
from reconstruct.gaussians.windows import make_windows

CAMERA = Camera.from_fov(97, 74, 0.6)
PLANE = np.array([0.5, 0.7, 1.0])
"""Points p with PLANE . p = 1: inverse depth falls over the picture."""
BOX = np.s_[21:52, 33:71]


def plane_depth(rows, columns, K=CAMERA.K):
    ray = np.stack([(columns + 0.5 - K[0, 2]) / K[0, 0], (rows + 0.5 - K[1, 2]) / K[1, 1], 1 + 0 * rows], -1)
    return 1 / (ray @ PLANE)


def a_frame():
    """A slanted plane with a straight rim, its colours affine in the picture; something farther behind it."""
    rows, columns = np.indices((CAMERA.height, CAMERA.width)).astype(float)
    depth, mask = plane_depth(rows, columns), np.zeros((CAMERA.height, CAMERA.width), bool)
    mask[BOX] = True
    rgb = np.stack([columns + 20, 2 * rows + 30, 0 * rows + 7], -1).astype(np.uint8)
    return Frame(rgb, np.where(mask, depth, 2 * depth).astype(np.float32), mask)


def windows(frames, factor):
    """All that is asked of a scene is the size of pixels, and of the foreground."""
    recording = Recording(CAMERA, np.arange(len(frames)) / 30, frames.__getitem__)
    masks = np.stack([frame.mask for frame in frames])
    scene = types.SimpleNamespace(mask=masks, factor=1, footprint=1 / CAMERA.K[0, 0], diagonal=0.3)
    pixels = masks.sum((1, 2)).mean()
    found = make_windows(recording, scene, pixels if factor == 1 else pixels / (factor - 0.5) ** 2)
    assert found.factor == factor
    return found


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
def test_pixels_stand_on_the_rays_of_their_lens(factor):
    """Depth and colours: those of the plane where a window's pixels have their centres."""
    found = windows([a_frame()] * 3, factor)
    window, lens = found[1], found[1].lens
    h, w = window.mask.shape
    assert (lens.height, lens.width) == (h, w) == window.depth.shape == window.rgb.shape[:2]
    assert found.footprint == pytest.approx(factor / CAMERA.K[0, 0])
    K = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    rows, columns = np.indices((h, w)).astype(float)
    there = window.depth > 0
    expected = plane_depth(rows, columns, K)
    slope = np.abs(np.diff(expected, axis=0)).max()
    assert there.sum() > 0.5 * 31 * 38 / factor**2
    assert np.abs(window.depth - expected)[there].max() < 0.1 * slope, "a tenth of a pixel"
    # where a window's pixel has its centre in the recording's picture, from whose pixels colours were taken
    u = (columns + 0.5 - lens.cx) / lens.fx * CAMERA.K[0, 0] + CAMERA.K[0, 2] - 0.5
    v = (rows + 0.5 - lens.cy) / lens.fy * CAMERA.K[1, 1] + CAMERA.K[1, 2] - 0.5
    np.testing.assert_allclose(window.rgb[..., 0], u + 20, atol=0.51)
    np.testing.assert_allclose(window.rgb[..., 1], 2 * v + 30, atol=0.51)
    assert not (window.depth[~window.mask] > 0).any() and not (window.depth[window.mask] < 0).any()
