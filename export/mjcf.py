"""Writes MJCF: of exported assets, and of any asset's URDF. MuJoCo's own import of URDF drops paths, visual meshes and
velocity limits."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import zip_longest

import numpy as np

from export.model import WORLD, AssetModel, LinkModel
from export.settings import Base
from export.stated_trust import trust_comment
from export.urdf import primitive_shape
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.files.urdf import (
    UrdfInertial,
    UrdfJoint,
    UrdfLink,
    UrdfShape,
    child_joints,
    number_text,
    read_urdf,
)
from freeart21.joint import Joint, JointType
from freeart21.se3 import Array

STIFF_FRICTION = {"solreffriction": "0.002 1", "solimpfriction": "0.999 0.999 0.001"}
"""MuJoCo's friction is a soft constraint, and with its defaults a joint held by friction creeps: a pendulum was .9 % of
its swing off after 3 s, with these .2 %, at steps of 1 ms."""
STIFF_LIMIT = "0.004 1"
"""Limits are soft, too: a lighter's lid was .4 degrees beyond one with the default of 0.02 s. This is twice MuJoCo's
default time step, the minimum."""
ROLLING = (0.005, 0.0001)
"""m: torsional and rolling friction, MuJoCo's own defaults. It has no restitution."""
_ADDITIVE = ("damping", "frictionloss", "armature")  # attributes that add up over effects
_KINDS: dict[JointType, str] = {"revolute": "hinge", "prismatic": "slide"}
_SEEN = {"group": "2", "contype": "0", "conaffinity": "0", "mass": "0"}
"""Attributes of visual geoms."""
_MESHES = (".obj", ".stl", ".msh")
"""Mesh formats that MuJoCo reads. Shapes in others are left out; inertia comes from the URDF."""


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
    body, name = ET.SubElement(parent, "body", name=link.name), f"{link.name}_visual"
    body.append(_inertial(link.inertial))
    visual = {"type": "mesh", "name": name, "mesh": name, **_SEEN}
    ET.SubElement(assets, "mesh", name=name, file=link.visual, inertia="shell")
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
        name = f"{link.name}_collision_{k:02d}"
        ET.SubElement(body, "geom", _shape(primitive_shape(shape)) | surface, name=name, group="3", mass="0")
    return body


def _joint(model: AssetModel) -> ET.Element:
    joint, effort = model.joint, number_text(-model.effort, model.effort)
    return _free_joint(joint, joint.type, model.effects, solreflimit=STIFF_LIMIT, actuatorfrcrange=effort)


def _free_joint(joint: Joint | UrdfJoint, kind: JointType, effects: tuple[Effect, ...], **more: str) -> ET.Element:
    """The <joint> of a hinge or slider at the origin of its body."""
    out = ET.Element("joint", name=joint.name, type=_KINDS[kind], axis=number_text(*joint.axis))
    if np.isfinite([joint.lower, joint.upper]).all():
        out.set("range", number_text(joint.lower, joint.upper))
    out.attrib.update(more | joint_attributes(effects, joint.name))
    return out


def _inertial(of: UrdfInertial) -> ET.Element:
    moments = number_text(*np.diag(of.inertia), of.inertia[0, 1], of.inertia[0, 2], of.inertia[1, 2])
    return ET.Element("inertial", pos=number_text(*of.centre), mass=number_text(of.mass), fullinertia=moments)


def _shape(shape: UrdfShape) -> dict[str, str]:
    """Type, pose and, of a primitive, size of a `<geom>`; MJCF takes half sizes."""
    halves = {"box": (0.5, 0.5, 0.5), "sphere": (1.0,), "cylinder": (1.0, 0.5), "capsule": (1.0, 0.5)}.get(shape.kind)
    size = {} if halves is None else {"size": number_text(*(shape.size * halves))}
    return {"type": shape.kind, **_place(shape.T_link_shape), **size}


def _place(T: Array) -> dict[str, str]:
    return {"pos": number_text(*T[:3, 3]), "quat": number_text(*se3.wxyz(T))}


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


def urdf_to_mjcf(asset: Asset, base: Base = "fixed") -> bytes:
    """Any asset's URDF as MJCF, to be saved beside the URDF: mesh files keep their names. Textures are dropped, as
    MuJoCo reads no MTL. The asset's joint moves, others are held, links do not collide, as in `simulate`.

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
            body.attrib.update(_place(joint.transform(_held_position(asset, joint))))
            if joint.name == asset.joint:
                effects = asset.effects.get(joint.name, ())
                body.append(_free_joint(joint, joint.joint_type or "revolute", effects))
        _fill(body, urdf.links[name], assets)
        pending += [(body, j.child, j) for j in below.get(name, ())]
    ET.indent(model)
    return bytes(ET.tostring(model, encoding="utf-8")) + b"\n"


def _held_position(asset: Asset, joint: UrdfJoint) -> float:
    """Position at which a joint's child is placed: zero for the asset's joint, else the held position."""
    return 0.0 if joint.name == asset.joint else asset.held.get(joint.name, float(np.clip(0, joint.lower, joint.upper)))


def _fill(body: ET.Element, link: UrdfLink, assets: ET.Element) -> None:
    """Inertia and shapes of a link."""
    if link.inertial is not None and link.inertial.mass > 0 and body.tag == "body":
        body.append(_inertial(link.inertial))
    touched = {"group": "3", "contype": "1", "conaffinity": "0"}  # collides with other objects only
    for shapes, words in ((link.visuals, _SEEN), (link.collisions, touched)):
        for shape in shapes:
            geom = _shape(shape)
            if shape.kind == "mesh":
                if "://" in shape.filename:
                    raise FreeArtError(f"mesh '{shape.filename}' is named by an address, expected a path")
                if not shape.filename.lower().endswith(_MESHES):
                    continue
                name, scale = f"mesh_{len(assets)}", number_text(*shape.size)
                ET.SubElement(assets, "mesh", name=name, file=shape.filename, scale=scale, inertia="shell")
                geom["mesh"] = name
            elif "size" not in geom:
                continue
            look = {} if shape.rgba is None else {"rgba": number_text(*shape.rgba)}
            ET.SubElement(body, "geom", geom | words | look)
