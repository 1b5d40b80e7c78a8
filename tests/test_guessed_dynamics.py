"""Friction and damping of a joint that nobody measured."""

from __future__ import annotations

import numpy as np
import pytest

from export.guessed_dynamics import guess_effects
from freeart21.effects import CoulombFriction
from freeart21.files.urdf import UrdfInertial
from freeart21.joint import Joint

BODY = UrdfInertial(2.0, np.array([0.1, 0.0, 0.0]), 0.01 * np.eye(3))  # its middle is .1 m in front of a hinge along y
WEIGHT = 2.0 * 9.81


def friction(kind, axis, lower, upper):
    joint = Joint("joint", kind, np.array(axis, float), np.zeros(3), lower, upper)
    (found,) = (effect for effect in guess_effects(joint, BODY) if isinstance(effect, CoulombFriction))
    return found.level


@pytest.mark.parametrize(
    ("lower", "upper", "expected"), [(-1.0, 0.0, 0.01), (0.0, 1.0, 1.5), (-0.2, 0.2, 1.5), (0.0, 0.0, 0.01)]
)
def test_a_lid_that_its_weight_would_open_is_held_and_one_that_rests_on_its_limit_is_not(lower, upper, expected):
    assert friction("revolute", [0, 1, 0], lower, upper) == pytest.approx(expected * WEIGHT * 0.1)


def test_a_drawer_whose_axis_leans_stays_where_it_was_put():
    lean = np.radians(1.0)
    out = [np.cos(lean), 0, -np.sin(lean)]
    assert friction("prismatic", out, 0.0, 0.3) == pytest.approx(1.5 * WEIGHT * np.sin(lean))
    assert friction("prismatic", out, -0.3, 0.0) == pytest.approx(0.01 * WEIGHT)


def test_a_door_about_a_vertical_axis_has_the_share_of_its_weight():
    assert friction("revolute", [0, 0, 1], -1.0, 1.0) == pytest.approx(0.01 * WEIGHT * 0.1)
