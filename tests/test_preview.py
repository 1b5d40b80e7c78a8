"""The picture that an asset carries."""

from pathlib import Path

import numpy as np
from engine_case import write_case

from export.preview import FILE, SIDE, render_preview
from freeart21.files import checked


def test_both_ends_of_the_joint_are_shown_whole_in_the_assets_colour(tmp_path: Path) -> None:
    asset = write_case(tmp_path, "revolute")
    picture = render_preview(asset)
    assert picture.shape == (SIDE, 2 * SIDE, 3)
    np.testing.assert_array_equal(picture, checked.read_rgb(tmp_path / FILE))
    ground = picture[0, 0].astype(int)
    drawn = np.abs(picture.astype(int) - ground).max(-1) > 30
    left, right = drawn[:, :SIDE], drawn[:, SIDE:]
    for half in (left, right):
        assert half.any() and not (half[[0, -1]].any() or half[:, [0, -1]].any())
    assert (left != right).sum() > 100, "the moving part stands elsewhere"
    red = picture[drawn & ~np.roll(~drawn, 3, 0) & ~np.roll(~drawn, -3, 0)].astype(float)
    hue = red.mean(0) / red.mean(0).max()
    np.testing.assert_allclose(hue, np.array([200, 30, 20]) / 200, atol=0.1)
