"""Shapes of bent, moulded and drawn things have the volumes, sizes and holes of their closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from manifold3d import CrossSection

from generator.shapes import loft, moulded, plate, rounded_outline, text_outline, tube

CORNER = 1 - np.pi / 4
"""What rounding to radius 1 takes off a square corner; its centroid lies `IN` away from either side."""
IN = (10 - 3 * np.pi) / (3 * (4 - np.pi))


def _loop(knotted: bool, n: int = 60) -> np.ndarray:
    """A circle, or a trefoil knot, whose wire comes back turned to where it began."""
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    if not knotted:
        return np.stack([2 * np.cos(t), 2 * np.sin(t), 0 * t], -1)
    r = 2 + 0.6 * np.cos(3 * t)
    return np.stack([r * np.cos(2 * t), r * np.sin(2 * t), 0.6 * np.sin(3 * t)], -1)


def test_a_moulded_disc_with_a_hole_lacks_what_its_four_round_rims_take() -> None:
    outer, inner, thick, r = 5.0, 2.0, 1.2, 0.4
    disc = moulded(CrossSection.circle(outer, 512) - CrossSection.circle(inner, 512), thick, "z", 3.0, r, 24)
    rims = 2 * r**2 * CORNER * 2 * np.pi * ((outer - IN * r) + (inner + IN * r))
    assert disc.volume() == pytest.approx(np.pi * (outer**2 - inner**2) * thick - rims, rel=1e-3)
    assert disc.genus() == 1
    assert np.allclose(disc.bounding_box(), (-5, -5, 2.4, 5, 5, 3.6))


def test_rims_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"rims of radius 0\.6 do not fit"):
        moulded(rounded_outline(3, 2, 0.3), 1.5, "z", 0.0, 0.6)
    with pytest.raises(ValueError, match="rims of radius 0.4 meet"):
        moulded(CrossSection.circle(2, 64) - CrossSection.circle(1.5, 64), 1.0, "z", 0.0, 0.4)


def test_a_loft_through_two_squares_is_a_frustum() -> None:
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    solid = loft([square, 0.5 * square + [0, 0, 3]])
    assert solid.volume() == pytest.approx(3 / 3 * (4 + 1 + 2))
    with pytest.raises(ValueError, match="not a solid"):
        loft([square[::-1], 0.5 * square[::-1] + [0, 0, 3]])


@pytest.mark.parametrize("knotted", [False, True])
def test_a_closed_wire_has_the_volume_of_its_length_even_where_it_twists(knotted: bool) -> None:
    path = _loop(knotted)
    wire = tube(path, 0.1, 32, closed=True)
    length = np.linalg.norm(np.roll(path, -1, 0) - path, axis=1).sum()
    section = 16 * np.sin(2 * np.pi / 32) * 0.1**2  # of the 32-gon; bends take 0.8 %, a joint out of step 0.7 % more
    assert wire.genus() == 1 and wire.volume() == pytest.approx(section * length, rel=0.011)


def test_letters_are_as_high_or_wide_as_asked_and_keep_their_holes() -> None:
    u0, v0, u1, v1 = text_outline("HOLE", 0.005).bounds()
    assert v1 - v0 == pytest.approx(0.005) and np.allclose([u0 + u1, v0 + v1], 0, atol=1e-9)
    u0, _, u1, _ = text_outline("HOLE", 0.005, 0.008).bounds()
    assert u1 - u0 == pytest.approx(0.008)
    assert plate(text_outline("O", 1.0), 0.1, "z").genus() == 1 and len(text_outline("i", 1.0).decompose()) == 2
