"""Results of methods that reconstruct an object from many views of two joint states instead of a video.

They give a joint and the parts in the first state, in a world frame of their own, without poses, part masks or states
per frame. Such an answer is placed in one frame of the video, the anchor, which must show the first state. Its files do
not define the camera's pose in that world (`Request.T_camera_world`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from freeart21.joint import Joint, JointType
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from leaderboard.adapters.layout import Frame, ImportedResult, Request
from leaderboard.adapters.readers import unit_vector

TYPE_GIVEN = "the joint type is an input of the method: joint_type says nothing about it"


def two_state_result(
    folder: Path,
    request: Request,
    default: Frame,
    joint_type: JointType,
    axis: ArrayLike,
    pivot: Array,
    span: float | tuple[float, float],
    meshes: tuple[Mesh, Mesh] | None,
    notes: tuple[str, ...] = (),
) -> ImportedResult:
    """The result of a layout without video, in its own world frame (`default`, unless the user names one), metres.

    `span` is the motion from the first state to the second, rad or m, or the joint's two limits. `meshes` are the parts
    in the first state, which is state zero.
    """
    T_camera_world = request.T_camera_world(folder, default)
    limits = span if isinstance(span, tuple) else (min(0.0, span), max(0.0, span))
    axis = unit_vector(axis, f"{folder}: the joint's axis")
    joint = Joint("joint", joint_type, axis, np.asarray(pivot, float), *limits)
    note = f"it has no poses: it is placed in frame {request.anchor}, assumed to show joint state zero"
    return ImportedResult(joint, anchor=request.anchor, anchor_pose=T_camera_world, meshes=meshes, notes=(note, *notes))
