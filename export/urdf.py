"""Writes URDF: relative paths, unique names, full limits, inertia, and the effects that URDF can express."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from export.model import WORLD, AssetModel, LinkModel, number_text
from export.primitives import Box, Cylinder, Primitive, Sphere
from export.stated_trust import trust_comment


def format_urdf(model: AssetModel) -> bytes:
    """The URDF file. The root link is free, or fixed to a link `world`.

    The `<mujoco>` element keeps MuJoCo from dropping visual meshes and paths and from merging the root link into the
    world.
    """
    robot = ET.Element("robot", name=model.name)
    robot.append(ET.Comment(trust_comment(model.trust)))
    compiler = {"strippath": "false", "discardvisual": "false", "fusestatic": "false"}
    ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", compiler)
    if model.base == "fixed":
        ET.SubElement(robot, "link", name=WORLD)
        mount = ET.SubElement(robot, "joint", name=f"{WORLD}_to_{model.root.name}", type="fixed")
        ET.SubElement(mount, "parent", link=WORLD)
        ET.SubElement(mount, "child", link=model.root.name)
    for link in (model.root, model.child):
        robot.append(_link(link))
    robot.append(_joint(model))
    ET.indent(robot)
    return bytes(ET.tostring(robot, encoding="utf-8", xml_declaration=True)) + b"\n"


def _link(link: LinkModel) -> ET.Element:
    element = ET.Element("link", name=link.name)
    inertial = ET.SubElement(element, "inertial")
    ET.SubElement(inertial, "origin", xyz=number_text(*link.inertial.centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=number_text(link.inertial.mass))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = link.inertial.inertia
    moments = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ET.SubElement(inertial, "inertia", {name: number_text(value) for name, value in moments.items()})
    _mesh(ET.SubElement(element, "visual", name=f"{link.name}_visual"), link.visual)
    for k, hull in enumerate(link.hulls):
        _mesh(ET.SubElement(element, "collision", name=f"{link.name}_collision_{k:02d}"), hull)
    for k, shape in enumerate(link.primitives, len(link.hulls)):
        _primitive(ET.SubElement(element, "collision", name=f"{link.name}_collision_{k:02d}"), shape)
    return element


def _mesh(element: ET.Element, filename: str) -> None:
    ET.SubElement(element, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(ET.SubElement(element, "geometry"), "mesh", filename=filename)


def _primitive(element: ET.Element, shape: Primitive) -> None:
    element.append(origin_element(shape.T_link_shape))
    geometry = ET.SubElement(element, "geometry")
    match shape:
        case Box():
            ET.SubElement(geometry, "box", size=number_text(*shape.size))
        case Cylinder():
            ET.SubElement(geometry, "cylinder", radius=number_text(shape.radius), length=number_text(shape.length))
        case Sphere():
            ET.SubElement(geometry, "sphere", radius=number_text(shape.radius))


def origin_element(T: NDArray[np.float64]) -> ET.Element:
    """The <origin> of a pose (4, 4)."""
    with warnings.catch_warnings():  # in gimbal lock any solution will do
        warnings.simplefilter("ignore", UserWarning)
        rpy = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")  # about fixed axes, as URDF's roll, pitch and yaw
    return ET.Element("origin", xyz=number_text(*T[:3, 3]), rpy=number_text(*rpy))


def _joint(model: AssetModel) -> ET.Element:
    joint = model.joint
    element = ET.Element("joint", name=joint.name, type=joint.type)
    ET.SubElement(element, "parent", link=model.root.name)
    ET.SubElement(element, "child", link=model.child.name)
    ET.SubElement(element, "origin", xyz=number_text(*joint.pivot), rpy="0 0 0")
    ET.SubElement(element, "axis", xyz=number_text(*joint.axis))
    ET.SubElement(
        element,
        "limit",
        lower=number_text(joint.lower),
        upper=number_text(joint.upper),
        effort=number_text(model.effort),
        velocity=number_text(model.velocity),
    )
    terms = [effect.urdf_dynamics() for effect in model.effects]
    dynamics = {key: float(np.sum([term.get(key, 0.0) for term in terms])) for key in ("damping", "friction")}
    ET.SubElement(element, "dynamics", {key: number_text(value) for key, value in dynamics.items()})
    return element
