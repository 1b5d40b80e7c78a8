"""The 3D view of an asset: every link of its URDF, a slider for every movable joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.urdf import UrdfJoint
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.se3 import Array, inverse
from freeart21.view.document import MOVING, REFERENCE
from freeart21.view.link_shapes import ShownUrdf
from freeart21.view.parts import AXIS, FIRST_VIEW
from freeart21.view.scene import Layer, Link, Scene, Slider, Surface, axis_mesh, link_poses, slider_range
from freeart21.view.simplify import joined

LINK_COLOURS = (REFERENCE, MOVING, "#56B4E9", "#CC79A7", "#F0E442", "#D55E00", "#8C8C8C")
"""Colours of the bodies, in the order of the tree."""
HULL_COLOURS = ((86, 180, 233), (0, 158, 115), (230, 159, 0), (204, 121, 167), (240, 228, 66), (0, 114, 178))
"""Colours of collision shapes in turn, to distinguish the pieces of a decomposition."""


def asset_scene(shown: ShownUrdf, asset: Asset | None = None, T_camera_canonical: Array | None = None) -> Scene:
    """All links of a URDF, a layer for every body, and a layer of collision shapes, hidden at first.

    Sliders are first at the asset's state zero and held positions, else at zero or the nearest limit. The world is the
    root link, z up; with `T_camera_canonical` (4, 4) and an asset it is the asset's canonical frame, seen from that
    camera.
    """
    values: dict[str, float] = {} if asset is None else {**asset.held, asset.joint: asset.state_zero}
    urdf = shown.urdf
    names = list(urdf.parents_first)
    into = {joint.child: joint for joint in urdf.joints.values()}
    sliders: list[Slider] = []
    index: dict[str, int] = {}
    size = bounding_diagonal(*(piece.mesh for pieces in shown.visuals.values() for piece in pieces)) or 1.0
    for joint in urdf.joints.values():
        if joint.joint_type and joint.mimic is None:
            index[joint.name] = len(sliders)
            start = values.get(joint.name, float(np.clip(0.0, joint.lower, joint.upper)))
            lower, upper = slider_range(_at_child(joint), [start], size)
            sliders.append(Slider(joint.name, joint.joint_type, lower, upper, start))
    links: list[Link] = []
    for name in names:
        above = into.get(name)
        if above is None:
            links.append(Link(-1))
            continue
        parent, T = names.index(above.parent), above.T_parent_joint
        if above.joint_type is None:
            links.append(Link(parent, T))
            continue
        leader, scale, offset = above.mimic or (above.name, 1.0, 0.0)
        if leader not in index:
            raise FreeArtError(f"{urdf.path}: joint '{above.name}' mimics '{leader}'; joints: {', '.join(index)}")
        links.append(Link(parent, T, _at_child(above), index[leader], scale, offset))
    up, towards = np.array([0.0, 0.0, 1.0]), np.array([-1.0, -0.75, 0.55])
    if asset is not None and T_camera_canonical is not None:
        R_canonical_camera = T_camera_canonical[:3, :3].T
        up, towards = R_canonical_camera @ [0.0, -1.0, 0.0], R_canonical_camera @ FIRST_VIEW
        first = link_poses(links, [slider.value for slider in sliders])[names.index(asset.reference_link)]
        T_world_root = asset.T_canonical_reference @ inverse(first)
        links = [Link(-1, T_world_root), *(replace(link, parent=link.parent + 1) for link in links)]
    return _scene(shown, asset, links, sliders, up, towards)


def _scene(
    shown: ShownUrdf, asset: Asset | None, links: list[Link], sliders: list[Slider], up: Array, towards: Array
) -> Scene:
    """The scene with visuals by body, axes, and collision shapes on their links."""
    shift = len(links) - len(shown.visuals)
    position = {name: i + shift for i, name in enumerate(shown.visuals)}
    layers: list[Layer] = []
    surfaces: list[Surface] = []
    for name, body in _bodies(shown, asset):
        colour = LINK_COLOURS[len(layers) % len(LINK_COLOURS)]
        surfaces += [
            Surface(piece.mesh, position[link], len(layers), piece.uv, piece.picture)
            for link in body
            for piece in shown.visuals[link]
        ]
        layers.append(Layer(name, colour))
    axes, hulls = len(layers), len(layers) + 1
    layers += [Layer("joint axes", AXIS, "axis"), Layer("collision shapes", "#009E73", "ghost", False)]
    for link, (owner, visuals) in zip(links[shift:], shown.visuals.items(), strict=True):
        meshes = [piece.mesh for piece in visuals if not piece.mesh.empty]
        if link.joint is not None:
            near = box_centre(joined(*meshes)) if meshes else np.zeros(3)
            size = bounding_diagonal(*meshes) or 1.0
            surfaces.append(Surface(axis_mesh(link.joint, near, size), position[owner], axes))
        surfaces += [
            Surface(_painted(piece.mesh, HULL_COLOURS[i % len(HULL_COLOURS)]), position[owner], hulls)
            for i, piece in enumerate(shown.collisions[owner])
        ]
    return Scene(tuple(links), tuple(sliders), tuple(layers), tuple(surfaces), up, towards)


def _bodies(shown: ShownUrdf, asset: Asset | None) -> list[tuple[str, list[str]]]:
    """Groups of links that fixed joints join, by the first with visuals: the asset's two parts first, then down the
    tree."""
    fixed_to = {joint.child: joint.parent for joint in shown.urdf.joints.values() if joint.joint_type is None}
    groups: dict[str, list[str]] = {}
    for name in shown.visuals:
        top = name
        while top in fixed_to:
            top = fixed_to[top]
        groups.setdefault(top, []).append(name)
    bodies = [(seen[0], links) for links in groups.values() if (seen := [one for one in links if shown.visuals[one]])]
    first = [asset.reference_link, asset.moving_link] if asset is not None else []
    return sorted(bodies, key=lambda body: next((i for i, link in enumerate(first) if link in body[1]), len(first)))


def _at_child(joint: UrdfJoint) -> Joint:
    """A movable joint in its child link's frame."""
    assert joint.joint_type is not None
    return Joint(joint.name, joint.joint_type, joint.axis, np.zeros(3), joint.lower, joint.upper)


def _painted(mesh: Mesh, colour: tuple[int, int, int]) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces, np.tile(np.array(colour, np.uint8), (len(mesh.vertices), 1)))
