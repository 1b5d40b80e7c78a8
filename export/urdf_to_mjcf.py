"""Converts any asset's URDF to MJCF: one joint moves, others are held, links do not collide, as in `simulate`.

Exported assets have an MJCF of their own, with textures; this is for third-party URDFs.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from export.mjcf import joint_attributes
from export.model import WORLD, Base
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.urdf import UrdfInertial, UrdfJoint, UrdfLink, UrdfShape, child_joints, number_text, read_urdf
from freeart21.se3 import Array

_MESHES = (".obj", ".stl", ".msh")
"""Mesh formats that MuJoCo reads. Shapes in others are left out; inertia comes from the URDF."""


def urdf_to_mjcf(asset: Asset, base: Base = "fixed") -> bytes:
    """The MJCF file, to be saved beside the URDF: mesh files keep their names. Textures are dropped, as MuJoCo reads no
    MTL.

    A root link `world` is MuJoCo's world; with it the asset is fixed whatever `base` is. Raises FreeArtError when the
    URDF is not one tree, a number is invalid, or a mesh is named by an address.
    """
    urdf = read_urdf(asset.urdf)
    model = ET.Element("mujoco", model=urdf.name or "object")
    ET.SubElement(model, "compiler", angle="radian", autolimits="true")
    ET.SubElement(model, "option", integrator="implicitfast")
    assets = ET.SubElement(model, "asset")
    world = ET.SubElement(model, "worldbody")
    below = child_joints(urdf.joints.values())
    pending: list[tuple[ET.Element, str, UrdfJoint | None]] = [(world, urdf.root, None)]
    while pending:
        parent, name, joint = pending.pop(0)
        body = parent if name == WORLD and joint is None else ET.SubElement(parent, "body", name=name)
        if joint is None and base == "free" and body is not parent:
            ET.SubElement(body, "freejoint", name=f"{name}_free")
        if joint is not None:
            _place(body, joint.transform(_held_position(asset, joint)))
            if joint.name == asset.joint:
                body.append(_joint(asset, joint))
        _fill(body, urdf.links[name], assets)
        pending += [(body, j.child, j) for j in below.get(name, ())]
    ET.indent(model)
    return bytes(ET.tostring(model, encoding="utf-8")) + b"\n"


def _held_position(asset: Asset, joint: UrdfJoint) -> float:
    """Position at which a joint's child is placed: zero for the asset's joint, else the held position."""
    return 0.0 if joint.name == asset.joint else asset.held.get(joint.name, float(np.clip(0, joint.lower, joint.upper)))


def _joint(asset: Asset, joint: UrdfJoint) -> ET.Element:
    kind = {"revolute": "hinge", "prismatic": "slide"}[joint.joint_type or "revolute"]
    out = ET.Element("joint", name=joint.name, type=kind, axis=number_text(*joint.axis))
    if np.isfinite([joint.lower, joint.upper]).all():
        out.set("range", number_text(joint.lower, joint.upper))
    for word, value in joint_attributes(asset.effects.get(joint.name, ()), joint.name).items():
        out.set(word, value)
    return out


def _place(element: ET.Element, T: Array) -> None:
    element.set("pos", number_text(*T[:3, 3]))
    element.set("quat", number_text(*se3.wxyz(T)))


def _fill(body: ET.Element, link: UrdfLink, assets: ET.Element) -> None:
    """Inertia and shapes of a link."""
    if link.inertial is not None and link.inertial.mass > 0 and body.tag == "body":
        body.append(_inertial(link.inertial))
    for shapes, words in (
        (link.visuals, {"group": "2", "contype": "0", "conaffinity": "0", "mass": "0"}),
        (link.collisions, {"group": "3", "contype": "1", "conaffinity": "0"}),  # collides with other objects only
    ):
        for shape in shapes:
            geom = _geom(shape, assets)
            if geom is not None:
                geom.attrib |= words
                if shape.rgba is not None:
                    geom.set("rgba", number_text(*shape.rgba))
                body.append(geom)


def _inertial(of: UrdfInertial) -> ET.Element:
    moments = number_text(*np.diag(of.inertia), of.inertia[0, 1], of.inertia[0, 2], of.inertia[1, 2])
    return ET.Element("inertial", pos=number_text(*of.centre), mass=number_text(of.mass), fullinertia=moments)


def _geom(shape: UrdfShape, assets: ET.Element) -> ET.Element | None:
    geom = ET.Element("geom", type=shape.kind)
    _place(geom, shape.T_link_shape)
    match shape.kind:
        case "mesh":
            if "://" in shape.filename:
                raise FreeArtError(f"mesh '{shape.filename}' is named by an address, expected a path")
            if not shape.filename.lower().endswith(_MESHES):
                return None
            name = f"mesh_{len(assets)}"
            scale = number_text(*shape.size)
            ET.SubElement(assets, "mesh", name=name, file=shape.filename, scale=scale, inertia="shell")
            geom.set("mesh", name)
        case "box":
            geom.set("size", number_text(*(0.5 * shape.size)))
        case "sphere":
            geom.set("size", number_text(*shape.size))
        case "cylinder" | "capsule":
            radius, length = shape.size
            geom.set("size", number_text(radius, 0.5 * length))
        case _:
            return None
    return geom
