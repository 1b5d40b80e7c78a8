"""Articulate-Anything: the folder of one candidate, with the URDF that its program made.

    mobility.urdf (or the one *.urdf there)    and the meshes that it names, in the same folder

Read in vlongle/articulate-anything@1edb4b4a80e9679234e36873d91c52e0759d670c: articulate_anything/api/odio_urdf.py (a
robot is a URDF whose base joint is turned as PartNet-Mobility's, so that its root is the object's, z up; joints are
revolute or prismatic, in rad and m, with limits), articulate_anything/utils/metric.py (their evaluator compares joints
in that frame). Its joint_pred.py is a program, and is not run: run it there.

Meshes are retrieved from a library: they are as large as that object was, not as the video's. The joint position at
which the object stands in the video is not known: zero is taken for the anchor frame.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.joint import JointType
from freeart21.mesh import Mesh
from freeart21.view.link_shapes import read_shown
from leaderboard.adapters.toolbox import Found, Layout, Request, chosen, joined, scaled_mesh
from leaderboard.adapters.two_states import found


def _urdf(folder: Path) -> Path | None:
    """mobility.urdf, or the only URDF in the folder."""
    named, all_ = folder / "mobility.urdf", sorted(folder.glob("*.urdf"))
    return named if named.is_file() else all_[0] if len(all_) == 1 else None


def _read(folder: Path, request: Request) -> Found:
    path, scale = _urdf(folder), request.options.scale
    assert path is not None  # `_fits`
    shown = read_shown(path)
    urdf = shown.urdf
    movable = [name for name, joint in urdf.joints.items() if joint.joint_type is not None]
    name = movable[chosen(movable, request.options.joint, str(path))]
    joint, places = urdf.joints[name], urdf.link_poses({})
    kind: JointType = "revolute" if joint.joint_type == "revolute" else "prismatic"
    T = places[joint.child]
    beyond = {joint.child}
    while more := {j.child for j in urdf.joints.values() if j.parent in beyond} - beyond:
        beyond |= more
    if shown.missing:
        raise FreeArtError(f"{path} names {shown.missing[0]}, which does not exist")
    sides: tuple[list[Mesh], list[Mesh]] = ([], [])
    for link, pieces in shown.visuals.items():
        sides[link in beyond].extend(scaled_mesh(piece.mesh.moved(places[link]), scale) for piece in pieces)
    if not all(sides):
        raise FreeArtError(f"{path}: no link on one side of '{name}' has a visual")
    length = scale if kind == "prismatic" else 1.0
    limits = (joint.lower * length, joint.upper * length)
    axis, pivot = T[:3, :3] @ joint.axis, scale * T[:3, 3]
    note = f"joint '{name}' of its URDF, at position zero"
    return found(
        folder, request, "link", kind, axis, np.asarray(pivot), limits, (joined(sides[0]), joined(sides[1])), (note,)
    )


LAYOUT = Layout(
    "articulate-anything",
    "Articulate-Anything, https://github.com/vlongle/articulate-anything",
    "vlongle/articulate-anything@1edb4b4a80e9679234e36873d91c52e0759d670c:articulate_anything/api/odio_urdf.py",
    lambda folder: _urdf(folder) is not None,
    _read,
    inside=("joint_actor/iter_*/seed_*", "*"),
    frame="link",
    joint_choice=True,
)
