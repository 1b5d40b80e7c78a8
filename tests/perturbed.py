"""The made-up truth as an answer, wrong by a known amount: what the golden tests of every protocol score."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from synthetic_case import pictures, truth_as_answer, with_joint

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.mesh import Mesh
from leaderboard.protocol import Case

KINDS = ("revolute", "prismatic")
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def lid_centre(truth):
    """The centre of the moving part's surface."""
    lid = truth.articulation.moving
    return np.average(lid.vertices[lid.faces].mean(1), axis=0, weights=lid.areas())


def tilted(truth, degrees):
    """The axis turned by `degrees` about x, at its point nearest the moving part's centre."""
    joint = truth.articulation.joint
    nearest = joint.pivot + ((lid_centre(truth) - joint.pivot) @ joint.axis) * joint.axis
    axis = se3.exp_so3([np.deg2rad(degrees), 0, 0]) @ joint.axis
    return with_joint(truth_as_answer(truth), replace(joint, axis=axis, pivot=nearest))


def shifted(truth, across=0.0, along=0.0):
    """The pivot moved by metres across the axis and along it."""
    joint = truth.articulation.joint
    side = np.array([np.cos(0.4), 0, np.sin(0.4)])
    return with_joint(truth_as_answer(truth), replace(joint, pivot=joint.pivot + across * side + along * joint.axis))


def reversed_axis(truth):
    return with_joint(truth_as_answer(truth), truth.articulation.joint.reversed(), -truth.states)


def with_states(truth, states):
    return replace(truth_as_answer(truth), states=np.asarray(states, float))


def other_type(truth):
    joint = truth.articulation.joint
    return with_joint(truth_as_answer(truth), replace(joint, type=KINDS[joint.type == "revolute"]))


def with_parts(answer, reference=None, moving=None):
    parts = answer.articulation
    return replace(answer, articulation=Articulation(parts.joint, reference or parts.reference, moving or parts.moving))


def in_millimetres(truth):
    """Every length of the answer a thousand times too large."""
    answer, parts = truth_as_answer(truth), truth.articulation
    joint = replace(parts.joint, pivot=1000 * parts.joint.pivot)
    if joint.type == "prismatic":
        joint = replace(joint, lower=1000 * joint.lower, upper=1000 * joint.upper)
        answer = replace(answer, states=1000 * answer.states)

    def large(Ts):
        return se3.pose(Ts[:, :3, :3], 1000 * Ts[:, :3, 3])

    return replace(
        answer,
        articulation=Articulation(joint, *(Mesh(1000 * m.vertices, m.faces) for m in (parts.reference, parts.moving))),
        Ts_camera_reference=large(answer.Ts_camera_reference),
        Ts_camera_moving=large(answer.Ts_camera_moving),
    )


def with_poses(truth, change):
    """`change` applied to both stacks of poses (n, 4, 4)."""
    answer = truth_as_answer(truth)
    return replace(
        answer,
        Ts_camera_reference=change(answer.Ts_camera_reference),
        Ts_camera_moving=change(answer.Ts_camera_moving),
    )


def quaternions_confused(Ts):
    """Poses whose quaternions were written wxyz and read as xyzw."""
    wxyz = np.roll(Rotation.from_matrix(Ts[:, :3, :3]).as_quat(), 1, axis=-1)
    return se3.pose(Rotation.from_quat(wxyz).as_matrix(), Ts[:, :3, 3])


def opengl(Ts):
    """Poses of a camera that looks along -z with y up, taken for one of OpenCV."""
    return OPENGL @ Ts


def moving_part_off_by(truth, metres):
    """The moving part's mesh lifted off its place, along its own normal, and the joint left as it was."""
    lifted = truth.articulation.moving.moved(se3.pose(np.eye(3), [0, 0, metres]))
    return with_parts(truth_as_answer(truth), moving=lifted)


def values_of(protocol, truth, answer, renders=None, **more):
    return protocol.measure(Case(truth, answer, pictures(truth) if renders is None else renders), **more).values
