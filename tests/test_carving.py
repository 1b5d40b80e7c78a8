"""What slides sweeps: whatever its shape, as many copies of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from manifold3d import Manifold, OpType

from export import carving
from export.carving import _sweep_joint, _sweep_translation, is_valid
from freeart21.joint import Joint

WAY = np.array([0.0, 0.0, 0.03])
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def ball() -> Manifold:
    return Manifold.sphere(0.02, 48)


def hollow() -> Manifold:
    return ball() - Manifold.sphere(0.012, 32)


def spring() -> Manifold:
    """A coil of two turns about the way: what of it faces along the way lies above itself."""
    beads = [
        Manifold.sphere(0.005, 12).translate([0.02 * np.cos(a), 0.02 * np.sin(a), 0.01 * a / (2 * np.pi)])
        for a in np.linspace(0, 4 * np.pi, 36)
    ]
    return sum((a + b for a, b in pairwise(beads)), Manifold())


def touching() -> Manifold:
    """Two boxes that meet in an edge."""
    box = Manifold.cube([0.01, 0.01, 0.01])
    return box + box.translate([0.01, 0.01, 0.0])


@pytest.mark.parametrize("made", [ball, hollow, spring, touching])
@pytest.mark.parametrize("turned", [False, True], ids=["along an axis", "across all"])
def test_what_slides_sweeps_as_many_copies_of_it_do(made, turned):
    way = TURN @ WAY if turned else WAY
    tool = made().transform(np.column_stack([TURN, np.zeros(3)])) if turned else made()
    swept = _sweep_translation(tool, way)
    copies, doublings = tool, 8
    for k in range(doublings):
        copies = (copies + copies.translate(way * 2**k / (2**doublings - 1))).as_original().simplify(1e-6)
    assert is_valid(swept)
    assert swept.volume() == pytest.approx(copies.volume(), rel=2e-3)
    assert swept.volume() > 1.2 * tool.volume()
    outside = copies - swept
    assert outside.volume() < 1e-3 * copies.volume()


def test_a_union_that_only_grows_is_given_up_at_its_second_doubling(monkeypatch):
    """A brush of crossing needles: each copy of it crosses all others."""
    rng = np.random.default_rng(0)
    needles = [Manifold.cube([0.2, 0.002, 0.002], True).rotate(rng.uniform(0, 360, 3).tolist()) for _ in range(12)]
    brush = Manifold.batch_boolean(needles, OpType.Add)
    states = []

    class Counted(Joint):
        def transform(self, q):
            states.append(q)
            return super().transform(q)

    joint = Counted("hinge", "revolute", np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0, 2.0)
    monkeypatch.setattr(carving, "MAX_TRIANGLES", 20 * brush.num_tri())
    assert _sweep_joint(brush, joint, 0.0, 2.0, 8, 1e-6) is None
    assert len(states) <= 3
    plate = Manifold.cube([0.1, 0.1, 0.002], True)
    monkeypatch.setattr(carving, "MAX_TRIANGLES", 1000 * plate.num_tri())
    assert is_valid(_sweep_joint(plate, joint, 0.0, 2.0, 8, 1e-6))
