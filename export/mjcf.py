"""Writes MJCF directly: MuJoCo's own URDF import drops paths, visual meshes and velocity limits."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import zip_longest

from export.model import AssetModel, LinkModel
from export.primitives import Box, Cylinder, Primitive, Sphere
from export.stated_trust import trust_comment
from freeart21 import se3
from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.files.urdf import number_text

STIFF_FRICTION = {"solreffriction": "0.002 1", "solimpfriction": "0.999 0.999 0.001"}
"""MuJoCo's friction is a soft constraint, and with its defaults a joint held by friction creeps: a pendulum was .9 % of
its swing off after 3 s, with these .2 %, at steps of 1 ms."""
STIFF_LIMIT = "0.004 1"
"""Limits are soft, too: a lighter's lid was .4 degrees beyond one with the default of 0.02 s. This is twice MuJoCo's
default time step, the minimum."""
ROLLING = (0.005, 0.0001)
"""m: torsional and rolling friction, MuJoCo's own defaults. It has no restitution."""
_ADDITIVE = ("damping", "frictionloss", "armature")  # attributes that add up over effects


def format_mjcf(model: AssetModel) -> bytes:
    """The MJCF file: the root body is free or fixed to the world; the child body moves on the joint."""
    root = ET.Element("mujoco", model=model.name)
    root.append(ET.Comment(trust_comment(model.trust)))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    assets = ET.SubElement(root, "asset")
    world = ET.SubElement(root, "worldbody")
    body = _body(world, model.root, assets)
    if model.base == "free":
        body.insert(0, ET.Element("freejoint", name=f"{model.root.name}_free"))
    child = _body(body, model.child, assets)
    child.set("pos", number_text(*model.joint.pivot))
    child.insert(1, _joint(model))
    contact = ET.SubElement(root, "contact")
    ET.SubElement(contact, "exclude", body1=model.root.name, body2=model.child.name)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8")) + b"\n"


def _body(parent: ET.Element, link: LinkModel, assets: ET.Element) -> ET.Element:
    """A body with its inertia and geometry; its meshes and texture are added to `assets`."""
    body = ET.SubElement(parent, "body", name=link.name)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = link.inertial.inertia
    ET.SubElement(
        body,
        "inertial",
        pos=number_text(*link.inertial.centre),
        mass=number_text(link.inertial.mass),
        fullinertia=number_text(xx, yy, zz, xy, xz, yz),
    )
    visual = {
        "type": "mesh",
        "name": f"{link.name}_visual",
        "mesh": f"{link.name}_visual",
        "group": "2",
        "contype": "0",
        "conaffinity": "0",
        "mass": "0",
    }
    ET.SubElement(assets, "mesh", name=f"{link.name}_visual", file=link.visual, inertia="shell")
    if link.texture:
        ET.SubElement(assets, "texture", name=link.name, type="2d", file=link.texture)
        ET.SubElement(assets, "material", name=link.name, texture=link.name)
        visual["material"] = link.name
    ET.SubElement(body, "geom", visual)
    surface = {} if link.material is None else {"friction": number_text(link.material.friction, *ROLLING)}
    for k, hull in enumerate(link.hulls):
        name = f"{link.name}_collision_{k:02d}"
        ET.SubElement(assets, "mesh", name=name, file=hull)
        ET.SubElement(body, "geom", surface, type="mesh", name=name, mesh=name, group="3", mass="0")
    for k, shape in enumerate(link.primitives, len(link.hulls)):
        ET.SubElement(
            body, "geom", _primitive(shape) | surface, name=f"{link.name}_collision_{k:02d}", group="3", mass="0"
        )
    return body


def _primitive(shape: Primitive) -> dict[str, str]:
    """Type, size and pose of a `<geom>`; MJCF takes half sizes."""
    match shape:
        case Box():
            kind, size = "box", number_text(*(0.5 * shape.size))
        case Cylinder():
            kind, size = "cylinder", number_text(shape.radius, 0.5 * shape.length)
        case Sphere():
            kind, size = "sphere", number_text(shape.radius)
    T = shape.T_link_shape
    return {"type": kind, "size": size, "pos": number_text(*T[:3, 3]), "quat": number_text(*se3.wxyz(T))}


def _joint(model: AssetModel) -> ET.Element:
    joint = model.joint
    element = ET.Element(
        "joint",
        name=joint.name,
        type={"revolute": "hinge", "prismatic": "slide"}[joint.type],
        axis=number_text(*joint.axis),
        range=number_text(joint.lower, joint.upper),
        solreflimit=STIFF_LIMIT,
        actuatorfrcrange=number_text(-model.effort, model.effort),
    )
    for key, text in joint_attributes(model.effects, joint.name).items():
        element.set(key, text)
    return element


def joint_attributes(effects: tuple[Effect, ...], joint: str) -> dict[str, str]:
    """The attributes of `<joint>` that express these effects.

    Raises FreeArtError when two effects need the same attribute and it does not add up.
    """
    totals: dict[str, tuple[float, ...]] = {}
    for effect in effects:
        for key, value in effect.mjcf_joint().items():
            if key in totals and key not in _ADDITIVE:
                raise FreeArtError(f"joint '{joint}': two effects need MJCF's '{key}', which a joint has once")
            values = value if isinstance(value, tuple) else (value,)
            totals[key] = tuple(a + b for a, b in zip_longest(totals.get(key, ()), values, fillvalue=0.0))
    texts = {key: number_text(*values) for key, values in totals.items()}
    return texts | (STIFF_FRICTION if any(totals.get("frictionloss", ())) else {})
