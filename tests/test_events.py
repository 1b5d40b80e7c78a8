"""Impact, backlash and stiction in both simulations, against closed forms; both run the same code."""

from __future__ import annotations

import pytest

from freeart21 import events
from generator import simulate
from simgap.models import laws


def test_both_simulations_run_this_code():
    for name in ("drive_rebound", "meet_part", "part_at_limit", "touching_side"):
        assert getattr(laws, name).py_func is getattr(simulate, name) is getattr(events, name)


def test_backlash_contact_by_relative_motion():
    touching = events.touching_side
    assert [touching(0, 0.31, w, 0.2, 1.0, 0.0, 0.2) for w in (2.0, 0.5)] == [1, 0]
    assert [touching(0, 0.09, w, 0.2, 1.0, 0.0, 0.2) for w in (2.0, 0.5)] == [0, -1]
    assert [touching(side, 0, 0, 0, 0, push, 0.2) for side in (1, -1) for push in (-1.0, 1.0)] == [0, 1, -1, 0]


def test_impacts_conserve_momentum():
    v, w, side = events.meet_part(-1, 1.0, -3.0, False, 2.0, 0.5, 0.3, 0.0)
    assert v == w == pytest.approx((2.0 - 1.5) / 2.5) and side == -1
    for side, w in ((1, 3.0), (-1, -3.0)):
        assert events.meet_part(side, 0.0, w, True, 2.0, 0.5, 0.3, 0.0) == (0.0, pytest.approx(-0.3 * w), 0)
        assert events.meet_part(side, 0.0, w, True, 2.0, 0.5, 0.3, 1.0) == (0.0, 0.0, side)


def test_drive_side_at_a_limit():
    assert events.part_at_limit(-1, 1.0, 2.0, 0.0, 0.3) == (2.0, 0)
    assert events.part_at_limit(1, 1.0, 2.0, 0.0, 0.3) == (-0.6, 0)
    assert events.part_at_limit(1, 1.0, 2.0, -0.8, 0.0) == (-0.8, 1)
    assert events.part_at_limit(1, 1.0, 2.0, -0.6, 0.3) == (-0.6, 1)
