"""Writes URDF: relative paths, unique names, full limits, inertia, and the effects that URDF can express."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from export.model import WORLD, AssetModel, LinkModel
from export.primitives import Box, Cylinder, Primitive, Sphere
from export.stated_trust import trust_comment
from freeart21.files import urdf
from freeart21.files.urdf import Urdf, UrdfJoint, UrdfLink, UrdfShape


def format_urdf(model: AssetModel) -> bytes:
    """The URDF file. The root link is free, or fixed to a link `world`.

    The `<mujoco>` element keeps MuJoCo from dropping visual meshes and paths and from merging the root link into the
    world.
    """
    joint, root, child = model.joint, model.root.name, model.child.name
    terms = [effect.urdf_dynamics() for effect in model.effects]
    damping, friction = (float(np.sum([t.get(key, 0.0) for t in terms])) for key in ("damping", "friction"))
    moving = UrdfJoint(
        joint.name,
        joint.type,
        root,
        child,
        np.block([[np.eye(3), joint.pivot[:, None]], [np.eye(4)[3:]]]),
        joint.axis,
        joint.lower,
        joint.upper,
        True,
        model.effort,
        model.velocity,
        damping,
        friction,
    )
    links, joints = [_link(model.root), _link(model.child)], [moving]
    if model.base == "fixed":
        links.insert(0, UrdfLink(WORLD, (), (), None))
        mount = replace(moving, name=f"{WORLD}_to_{root}", type="fixed", parent=WORLD, child=root)
        joints.insert(0, replace(mount, T_parent_joint=np.eye(4)))
    compiler = {"strippath": "false", "discardvisual": "false", "fusestatic": "false"}
    return urdf.format_urdf(
        Urdf(
            Path(),
            model.name,
            {link.name: link for link in links},
            {j.name: j for j in joints},
            mujoco={"compiler": compiler},
        ),
        trust_comment(model.trust),
    )


def _link(link: LinkModel) -> UrdfLink:
    hulls = [UrdfShape("mesh", np.eye(4), np.ones(3), hull) for hull in link.hulls]
    shapes = [*hulls, *map(primitive_shape, link.primitives)]
    return UrdfLink(
        link.name,
        (UrdfShape("mesh", np.eye(4), np.ones(3), link.visual, name=f"{link.name}_visual"),),
        tuple(replace(shape, name=f"{link.name}_collision_{k:02d}") for k, shape in enumerate(shapes)),
        link.inertial,
    )


def primitive_shape(shape: Primitive) -> UrdfShape:
    """A collision shape of ours as a URDF's."""
    match shape:
        case Box():
            return UrdfShape("box", shape.T_link_shape, shape.size)
        case Cylinder():
            return UrdfShape("cylinder", shape.T_link_shape, np.array([shape.radius, shape.length]))
        case Sphere():
            return UrdfShape("sphere", shape.T_link_shape, np.array([shape.radius]))
