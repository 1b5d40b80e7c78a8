"""Articulate-Anything: the folder of one candidate, with the URDF of its program.

    mobility.urdf (or the only *.urdf there)    and the meshes that it names, in the same folder

Read in vlongle/articulate-anything@1edb4b4a80e9679234e36873d91c52e0759d670c: articulate_anything/api/odio_urdf.py (the
base joint is turned as PartNet-Mobility's, so that the URDF's root is the object's, z up; joints are revolute or
prismatic, rad and m, with limits), articulate_anything/utils/metric.py (their evaluator compares joints in that frame).
Its joint_pred.py is a program, which has to be run there; it is not run here.

Meshes are retrieved from a library and have the size of that object, not of the video's. The joint position in the
video is unknown: the anchor frame is assumed to show position zero.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files.urdf import subtree_links
from freeart21.joint import JointType
from freeart21.mesh import Mesh, join_meshes
from freeart21.view.link_shapes import read_shown
from leaderboard.adapters.layout import ImportedResult, Layout, Request
from leaderboard.adapters.readers import choose_joint, scale_mesh, two_state_result


def _find_urdf(folder: Path) -> Path | None:
    """mobility.urdf, or the only URDF in the folder."""
    preferred, urdfs = folder / "mobility.urdf", sorted(folder.glob("*.urdf"))
    return preferred if preferred.is_file() else urdfs[0] if len(urdfs) == 1 else None


def _read(folder: Path, request: Request) -> ImportedResult:
    path, scale = _find_urdf(folder), request.options.scale
    assert path is not None  # LAYOUT.matches
    shown = read_shown(path)
    urdf = shown.urdf
    movable = [name for name, joint in urdf.joints.items() if joint.joint_type is not None]
    name = movable[choose_joint(movable, request.options.joint, str(path))]
    joint, link_poses = urdf.joints[name], urdf.link_poses({})
    joint_type: JointType = "revolute" if joint.joint_type == "revolute" else "prismatic"
    T = link_poses[joint.child]
    if shown.missing:
        raise FreeArtError(f"{path} names {shown.missing[0]}, which does not exist")
    child_side = subtree_links(urdf.joints, joint.child)
    sides: tuple[list[Mesh], list[Mesh]] = ([], [])
    for link, pieces in shown.visuals.items():
        sides[link in child_side].extend(scale_mesh(piece.mesh.moved(link_poses[link]), scale) for piece in pieces)
    if not all(sides):
        raise FreeArtError(f"{path}: no link on one side of '{name}' has a visual")
    meshes = join_meshes(sides[0]), join_meshes(sides[1])
    length = scale if joint_type == "prismatic" else 1.0
    limits = (joint.lower * length, joint.upper * length)
    axis, pivot = T[:3, :3] @ joint.axis, np.asarray(scale * T[:3, 3])
    note = f"joint '{name}' of its URDF, at position zero"
    return two_state_result(folder, request, "link", joint_type, axis, pivot, limits, meshes, (note,))


LAYOUT = Layout(
    "articulate-anything",
    "Articulate-Anything, https://github.com/vlongle/articulate-anything",
    "vlongle/articulate-anything@1edb4b4a80e9679234e36873d91c52e0759d670c:articulate_anything/api/odio_urdf.py",
    lambda folder: _find_urdf(folder) is not None,
    _read,
    subfolders=("joint_actor/iter_*/seed_*", "*"),
    frame="link",
    has_several_joints=True,
)
