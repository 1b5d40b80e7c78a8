"""Windows of frames: the same rays as the recording's, and no depth that is not believed."""

import types

import numpy as np
import pytest

from freeart21.camera import Camera
from freeart21.recording import Frame, Recording
from reconstruct.gaussians.windows import MARGIN, Windows, make_windows

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


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
def test_silhouettes_are_not_shifted(factor):
    """Of discs that lie anyhow to the blocks: none the way of the rows or columns on the mean."""
    rows, columns = np.indices((CAMERA.height, CAMERA.width)) + 0.5
    frames = []
    for x, y, r in np.random.default_rng(1).uniform([36, 30, 12], [60, 44, 20], (200, 3)):
        mask = (columns - x) ** 2 + (rows - y) ** 2 < r**2
        frames.append(Frame(a_frame().rgb, a_frame().depth, mask))
    found, off = windows(frames, factor), []
    for i, frame in enumerate(frames):
        r, c = np.nonzero(found[i].mask)
        u = (c + 0.5 - found[i].lens.cx).mean() / found[i].lens.fx * CAMERA.K[0, 0] + CAMERA.K[0, 2]
        v = (r + 0.5 - found[i].lens.cy).mean() / found[i].lens.fy * CAMERA.K[1, 1] + CAMERA.K[1, 2]
        off.append([u - columns[frame.mask].mean(), v - rows[frame.mask].mean()])
    assert np.abs(np.mean(off, 0)).max() < 0.1, "recording's pixels"


@pytest.mark.parametrize("factor", [1, 2])
def test_the_object_stands_in_the_middle_of_its_window(factor):
    window = windows([a_frame()] * 3, factor)[0]
    rows, columns = np.flatnonzero(window.mask.any(1)), np.flatnonzero(window.mask.any(0))
    for seen, size in ((rows, window.lens.height), (columns, window.lens.width)):
        assert seen[0] in (MARGIN - 1, MARGIN) and size - 1 - seen[-1] in (MARGIN - 2, MARGIN - 1, MARGIN, MARGIN + 1)


def test_a_window_ends_where_the_picture_does():
    frame = a_frame()
    everywhere = Frame(frame.rgb, frame.depth, np.ones_like(frame.mask))
    window = windows([everywhere] * 3, 1)[0]
    assert window.mask.shape == frame.mask.shape and window.corner == (0, 0)
    assert (window.lens.cx, window.lens.cy) == (CAMERA.K[0, 2], CAMERA.K[1, 2])


def test_depth_off_the_object_is_negative():
    target = windows([a_frame()] * 3, 1)[0].target()
    assert (target.depth[~target.mask] == 0).all() and (target.around[target.mask] == 0).all()
    assert (target.around[~target.mask] > 1.2).all()
    assert target.colour.dtype == np.float32 and target.colour.max() <= 1


def test_depth_at_a_jump_is_not_believed():
    frame = a_frame()
    near = frame.depth.copy()
    near[21:52, 50:71] -= 0.2  # one half stands 0.2 nearer: some 20 pixels' worth
    near[30, 40] = 0
    window = windows([Frame(frame.rgb, near, frame.mask)] * 3, 1)[0]
    at = 33 - window.corner[0]
    depth = window.depth[21 - window.corner[1] :][:31, at : at + 38]
    believed = depth > 0
    assert not believed[:, 16:18].any(), "both sides of the jump"
    others = np.ones_like(believed)
    others[:, 16:18], others[9, 7] = False, False
    assert believed[others].all(), "and nothing else, nor the neighbours of a hole"
    assert not believed[9, 7]


def test_frames_that_show_nothing_have_no_window():
    frame = a_frame()
    hidden = Frame(frame.rgb, frame.depth, np.zeros_like(frame.mask))
    found = windows([frame, hidden, frame], 1)
    np.testing.assert_array_equal(found.nonempty, [True, False, True])
    assert found.frames[1] is None
    with pytest.raises(AssertionError):
        found[1]


def test_depth_weighs_as_much_as_the_sensor_is_exact():
    def unit(noise):
        return Windows((), footprint=1e-3, noise=noise, diagonal=0.2, factor=1).depth_unit

    assert unit(5e-3) == 0.1, "the paper's: half the diagonal"
    assert unit(0) == pytest.approx(1e-4 / 0.015) and unit(0) < unit(3e-4) < unit(1e-3) < 0.1
