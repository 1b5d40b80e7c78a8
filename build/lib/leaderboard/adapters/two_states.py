"""What methods share that reconstruct an object from many views of two joint states, and not from a video.

They give a joint and the parts as they stand in the first state, in a world of their own; no pose in any frame of a
video, no part masks and no state a frame. So an answer stands in one frame, the anchor: the frame of the video that is
in the first state. Where the world stands in that frame's camera, the files do not say (`Request.T_camera_world`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from freeart21.joint import Joint, JointType
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from leaderboard.adapters.toolbox import Found, Frame, Request, unit


def found(
    folder: Path,
    request: Request,
    default: Frame,
    kind: JointType,
    axis: ArrayLike,
    pivot: Array,
    span: float | tuple[float, float],
    meshes: tuple[Mesh, Mesh] | None,
    notes: tuple[str, ...] = (),
) -> Found:
    """The answer of a layout that has no video, in its own world, lengths in metres.

    `span` is the joint's motion from the first state to the second, rad or m, or its two limits. `meshes` are as in
    the first state, which is state zero.
    """
    T_camera_world = request.T_camera_world(folder, default)
    limits = span if isinstance(span, tuple) else (min(0.0, span), max(0.0, span))
    joint = Joint("joint", kind, unit(axis, f"{folder}: the joint's axis"), np.asarray(pivot, float), *limits)
    stands = (
        f"it has no poses: it stands in frame {request.anchor}, the one that it is taken to show at joint state zero"
    )
    return Found(joint, None, None, request.anchor, T_camera_world, None, meshes, None, (stands, *notes))


TOLD = "the method is told the joint type: joint_type is no merit of its own"
