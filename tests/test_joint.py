"""The joint as a screw."""

import numpy as np
import pytest
from refusal import assert_refused

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.joint import Joint

AXIS = np.array([2.0, -1, 2]) / 3
HINGE = Joint("hinge", "revolute", AXIS, np.array([0.1, 0.2, 0.3]), -1.0, 2.0)
SLIDE = Joint("slide", "prismatic", AXIS, np.zeros(3), 0.0, 0.4)
STATES = np.array([-3.0, -1e-9, 0.0, 0.5, np.pi, 7.0])


@pytest.mark.parametrize("joint", [HINGE, SLIDE])
def test_motion_is_the_exponential_of_the_screw(joint):
    np.testing.assert_allclose(joint.transform(STATES), se3.exp_se3(STATES[:, None] * joint.screw), atol=1e-12)


@pytest.mark.parametrize("joint", [HINGE, SLIDE])
def test_motions_add_up(joint):
    np.testing.assert_allclose(joint.transform(0.3) @ joint.transform(0.5), joint.transform(0.8), atol=1e-14)


def test_the_axis_stays_where_it_is():
    on_axis = HINGE.pivot + np.linspace(-1, 1, 5)[:, None] * AXIS
    np.testing.assert_allclose(se3.transform(HINGE.transform(1.1), on_axis), on_axis, atol=1e-15)


def test_right_hand_rule():
    hinge = Joint("z", "revolute", np.array([0.0, 0, 1]), np.zeros(3), -1, 1)
    np.testing.assert_allclose(se3.transform(hinge.transform(np.pi / 2), [[1.0, 0, 0]]), [[0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize("joint", [HINGE, SLIDE])
def test_another_frame_shows_the_same_motion(joint):
    T = se3.exp_se3([1, -2, 0.5, 0.4, 2.0, -1.0])
    expected = T @ joint.transform(0.7) @ se3.inverse(T)
    np.testing.assert_allclose(joint.moved(T).transform(0.7), expected, atol=1e-14)


@pytest.mark.parametrize("joint", [HINGE, SLIDE])
def test_a_reversed_joint_makes_the_same_motions_with_negated_states(joint):
    back = joint.reversed()
    np.testing.assert_allclose(back.transform(-STATES), joint.transform(STATES), atol=1e-14)
    assert (back.lower, back.upper) == (-joint.upper, -joint.lower)


def test_bad_joints_are_refused():
    with pytest.raises(FreeArtError, match="joint 'lid' axis has length 0.98, expected 1"):
        Joint("lid", "revolute", np.array([0.98, 0, 0]), np.zeros(3), 0, 1)
    with pytest.raises(FreeArtError, match="type 'floating', expected one of revolute, prismatic"):
        Joint("lid", "floating", AXIS, np.zeros(3), 0, 1)
    assert_refused(r"limits are \[1, 0\]", Joint, "lid", "revolute", AXIS, np.zeros(3), 1, 0)
    assert_refused("pivot", Joint, "lid", "revolute", AXIS, np.array([0, np.nan, 0]), 0, 1)
