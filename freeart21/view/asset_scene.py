"""The 3D view of an asset: every link of its URDF, a slider for every movable joint."""

from __future__ import annotations

import numpy as np

from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.urdf import UrdfJoint
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre, join_meshes
from freeart21.view.document import MOVING, REFERENCE
from freeart21.view.link_shapes import ShownUrdf
from freeart21.view.scene import Layer, Link, Scene, Slider, Surface, axis_mesh, slider_range
from freeart21.view.source import AXIS

LINK_COLOURS = (REFERENCE, MOVING, "#56B4E9", "#CC79A7", "#F0E442", "#D55E00", "#8C8C8C")
"""Colours of the bodies, in the order of the tree."""
HULL_COLOURS = ((86, 180, 233), (0, 158, 115), (230, 159, 0), (204, 121, 167), (240, 228, 66), (0, 114, 178))
"""Colours of collision shapes in turn, to distinguish the pieces of a decomposition."""


def asset_scene(shown: ShownUrdf, asset: Asset | None = None) -> Scene:
    """All links of a URDF, a layer for every body, and a layer of collision shapes, hidden at first.

    Sliders are first at the asset's state zero and held positions, else at zero or the nearest limit. The world is the
    root link, z up.
    """
    values: dict[str, float] = {} if asset is None else {**asset.held, asset.joint: asset.state_zero}
    joints, names = shown.urdf.joints.values(), list(shown.urdf.parents_first)
    size = bounding_diagonal(*(piece.mesh for pieces in shown.visuals.values() for piece in pieces)) or 1.0
    sliders: dict[str, Slider] = {}
    for joint in joints:
        if joint.joint_type and joint.mimic is None:
            start = values.get(joint.name, float(np.clip(0.0, joint.lower, joint.upper)))
            ends = slider_range(_at_child(joint), [start], size)
            sliders[joint.name] = Slider(joint.name, joint.joint_type, *ends, start)
    links = [Link(-1) for _ in names]
    for joint in joints:
        link = Link(names.index(joint.parent), joint.T_parent_joint)
        if joint.joint_type is not None:
            leader, scale, offset = joint.mimic or (joint.name, 1.0, 0.0)
            if leader not in sliders:
                raise FreeArtError(
                    f"{shown.urdf.path}: joint '{joint.name}' mimics '{leader}'; joints: {', '.join(sliders)}"
                )
            link = Link(link.parent, link.T_parent_link, _at_child(joint), list(sliders).index(leader), scale, offset)
        links[names.index(joint.child)] = link
    layers: list[Layer] = []
    surfaces: list[Surface] = []
    for name, body in _bodies(shown, asset):
        surfaces += [
            Surface(piece.mesh, names.index(link), len(layers), piece.uv, piece.picture)
            for link in body
            for piece in shown.visuals[link]
        ]
        layers.append(Layer(name, LINK_COLOURS[len(layers) % len(LINK_COLOURS)]))
    axes, hulls = len(layers), len(layers) + 1
    layers += [Layer("joint axes", AXIS, "axis"), Layer("collision shapes", "#009E73", "ghost", False)]
    for k, (link, owner) in enumerate(zip(links, names, strict=True)):
        if link.joint is not None:
            whole = join_meshes([piece.mesh for piece in shown.visuals[owner]])
            own = axis_mesh(link.joint, box_centre(whole), bounding_diagonal(whole) or size)
            surfaces.append(Surface(own, k, axes))
        surfaces += [
            Surface(_painted(piece.mesh, HULL_COLOURS[i % len(HULL_COLOURS)]), k, hulls)
            for i, piece in enumerate(shown.collisions[owner])
        ]
    return Scene(links, list(sliders.values()), layers, surfaces)


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
