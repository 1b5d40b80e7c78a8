"""Any asset's URDF as MJCF: one joint moves, others are held, links do not touch each other, as in simulate.

The assets of `exporter` have a MJCF of their own, with colours; this one is for the URDFs of others.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from export.mjcf import joint_words
from export.model import number_text
from export.urdf_numbers import numbers, origin_pose, told
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.asset import UrdfJoint, read_urdf_joints
from freeart21.joint import Joint
from freeart21.se3 import Array

_SHAPES = ("mesh", "box", "cylinder", "sphere")
_MESHES = (".obj", ".stl", ".msh")
"""Endings of meshes that MuJoCo reads; shapes of others are left out, and inertia is the URDF's anyway."""


def mjcf_of_urdf(asset: Asset) -> bytes:
    """The MJCF file, to lie beside the URDF: its mesh files are named as the URDF names them.

    Raises FreeArtError when the URDF is not one tree or holds what is no number, or a mesh is not named by a path.
    """
    robot = ET.fromstring(asset.urdf.read_bytes())
    joints = read_urdf_joints(asset.urdf)
    links = {link.get("name", ""): link for link in robot.findall("link")}
    above = {joint.child for joint in joints.values()}
    roots = [name for name in links if name not in above]
    if len(roots) != 1:
        raise FreeArtError(f"{asset.urdf} has roots {', '.join(roots) or 'none'}, expected one")
    model = ET.Element("mujoco", model=robot.get("name", "object"))
    ET.SubElement(model, "compiler", angle="radian", autolimits="true")
    ET.SubElement(model, "option", integrator="implicitfast")
    assets = ET.SubElement(model, "asset")
    world = ET.SubElement(model, "worldbody")
    elements = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    waiting: list[tuple[ET.Element, str, UrdfJoint | None]] = [(world, roots[0], None)]
    while waiting:
        parent, name, joint = waiting.pop(0)
        body = ET.SubElement(parent, "body", name=name)
        if joint is not None:
            element = elements[joint.name]
            _place(body, _stand(asset, joint, element))
            if joint.name == asset.joint:
                body.append(_joint(asset, joint, element))
        _fill(body, links[name], assets)
        waiting += [(body, j.child, j) for j in joints.values() if j.parent == name]
    ET.indent(model)
    return ET.tostring(model, encoding="utf-8") + b"\n"


def _stand(asset: Asset, joint: UrdfJoint, element: ET.Element) -> Array:
    """(4, 4) the child's frame in the parent's, the joint at zero, or where it is held."""
    T = origin_pose(element)
    if joint.joint_type is None or joint.name == asset.joint:
        return T
    q = asset.held.get(joint.name, float(np.clip(0.0, joint.lower, joint.upper)))
    ideal = Joint(joint.name, joint.joint_type, _axis(element), np.zeros(3), -np.inf, np.inf)
    return np.asarray(T @ ideal.transform(q))


def _axis(element: ET.Element) -> Array:
    axis = numbers(told(element, "axis", "xyz", "1 0 0"))
    return axis / np.linalg.norm(axis)


def _joint(asset: Asset, joint: UrdfJoint, element: ET.Element) -> ET.Element:
    kind = {"revolute": "hinge", "prismatic": "slide"}[joint.joint_type or "revolute"]
    out = ET.Element("joint", name=joint.name, type=kind, axis=number_text(*_axis(element)))
    if np.isfinite([joint.lower, joint.upper]).all():
        out.set("range", number_text(joint.lower, joint.upper))
    for word, value in joint_words(asset.effects.get(joint.name, ()), joint.name).items():
        out.set(word, value)
    return out


def _place(element: ET.Element, T: Array) -> None:
    element.set("pos", number_text(*T[:3, 3]))
    element.set("quat", number_text(*se3.wxyz(T)))


def _fill(body: ET.Element, link: ET.Element, assets: ET.Element) -> None:
    """Inertia and shapes of a link."""
    inertial = link.find("inertial")
    mass = 0.0 if inertial is None else float(numbers(told(inertial, "mass", "value", "0"), 1)[0])
    if inertial is not None and mass > 0:
        T = origin_pose(inertial)
        i = {
            k: float(numbers(told(inertial, "inertia", k, "0"), 1)[0])
            for k in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        }
        own = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])
        I = T[:3, :3] @ own @ T[:3, :3].T  # noqa: E741
        ET.SubElement(
            body,
            "inertial",
            pos=number_text(*T[:3, 3]),
            mass=number_text(mass),
            fullinertia=number_text(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]),
        )
    for tag in ("visual", "collision"):
        for shape in link.findall(tag):
            geom = _geom(shape, assets)
            if geom is None:
                continue
            if tag == "visual":
                geom.attrib |= {"group": "2", "contype": "0", "conaffinity": "0", "mass": "0"}
            else:  # touches what is not of this asset
                geom.attrib |= {"group": "3", "contype": "1", "conaffinity": "0"}
            body.append(geom)


def _geom(shape: ET.Element, assets: ET.Element) -> ET.Element | None:
    found = [shape.find(f"geometry/{kind}") for kind in _SHAPES]
    kind, geometry = next(((k, g) for k, g in zip(_SHAPES, found, strict=True) if g is not None), ("", None))
    if geometry is None:
        return None
    geom = ET.Element("geom", type=kind)
    _place(geom, origin_pose(shape))
    if kind == "mesh":
        name = f"mesh_{len(assets)}"
        file = geometry.get("filename", "")
        if "://" in file:
            raise FreeArtError(f"mesh '{file}' is named by an address, expected a path")
        if not file.lower().endswith(_MESHES):
            return None
        scale = number_text(*numbers(geometry.get("scale", "1 1 1")))
        ET.SubElement(assets, "mesh", name=name, file=file, scale=scale, inertia="shell")
        geom.set("mesh", name)
    elif kind == "box":
        geom.set("size", number_text(*(0.5 * numbers(geometry.get("size", "")))))
    elif kind == "sphere":
        geom.set("size", number_text(*numbers(geometry.get("radius", ""), 1)))
    else:
        radius, length = (float(numbers(geometry.get(k, ""), 1)[0]) for k in ("radius", "length"))
        geom.set("size", number_text(radius, 0.5 * length))
    return geom
