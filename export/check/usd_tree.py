"""Bodies and joints of a USD layer as a tree, as usd-core reads it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdPhysics

from export.check.tree import Tree
from export.model import WORLD
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import Urdf, UrdfInertial, UrdfJoint
from freeart21.se3 import Array

MAX_USD_BYTES = 512 << 20
"""Of a layer: two meshes of the largest size (`checklist.MAX_MESH_BYTES`)."""


def read_usd_tree(layer: Path, urdf: Urdf) -> tuple[Tree, dict[str, Array]]:
    """The tree of a layer that `urdf` was written to, with its names, and T_world_body (4, 4) by body.

    Needs usd-core. Raises FreeArtError for a layer that cannot be read, references others (no other file is opened),
    or counts in other units than m and kg with z up.
    """
    try:
        file = Sdf.Layer.OpenAsAnonymous(str(checked.require_file(layer, MAX_USD_BYTES)))
        others = file.GetCompositionAssetDependencies()
        if others:
            raise FreeArtError(f"it names {sorted(others)[0]}, expected a layer of its own")
        stage = Usd.Stage.Open(file)
    except Tf.ErrorException as error:
        raise FreeArtError((str(error).strip().splitlines() or [""])[-1]) from error
    units = (UsdGeom.GetStageMetersPerUnit(stage), UsdPhysics.GetStageKilogramsPerUnit(stage))
    if units != (1.0, 1.0) or UsdGeom.GetStageUpAxis(stage) != "Z":
        up = UsdGeom.GetStageUpAxis(stage)
        raise FreeArtError(f"it counts in {units[0]:g} m and {units[1]:g} kg with {up} up, expected 1 m, 1 kg and Z")
    names = {str(Tf.MakeValidIdentifier(name)): name for name in (*urdf.joints, *urdf.links)}
    prims = {names.get(str(prim.GetName()), str(prim.GetName())): prim for prim in stage.Traverse()}
    bodies = {name: prim for name, prim in prims.items() if prim.HasAPI(UsdPhysics.RigidBodyAPI)}
    found = [_read_joint(prim, name, names) for name, prim in prims.items() if prim.IsA(UsdPhysics.Joint)]
    place = {link: i for i, link in enumerate(urdf.parents_first)}
    joints = {joint.name: joint for joint in sorted(found, key=lambda joint: place.get(joint.child, 0))}
    inertials = {name: _read_inertial(prim) for name, prim in bodies.items() if prim.HasAPI(UsdPhysics.MassAPI)}
    placed = {
        name: np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)).T for name, prim in bodies.items()
    }
    links = ((WORLD,) if urdf.root == WORLD else ()) + tuple(bodies)
    return Tree(urdf.root, links, joints, inertials), placed


def _read_joint(prim: Any, name: str, names: Mapping[str, str]) -> UrdfJoint:
    joint = UsdPhysics.Joint(prim)
    parent, child = (
        next((names.get(str(path.name), str(path.name)) for path in end.GetTargets()), WORLD)
        for end in (joint.GetBody0Rel(), joint.GetBody1Rel())
    )
    T_parent, T_child = (
        se3.pose(_rotation(turn.Get()), np.array(place.Get(), float))
        for place, turn in (
            (joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
            (joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
        )
    )
    T = T_parent @ se3.inverse(T_child)
    kinds: dict[Any, Any] = {UsdPhysics.RevoluteJoint: "revolute", UsdPhysics.PrismaticJoint: "prismatic"}
    schema = next((each for each in kinds if prim.IsA(each)), None)
    if schema is None:
        return UrdfJoint(name, "fixed", parent, child, T, np.eye(3)[2])
    unit = np.pi / 180 if kinds[schema] == "revolute" else 1.0
    axis = T_child[:3, "XYZ".index(str(schema(prim).GetAxisAttr().Get()))]
    lower, upper = (
        unit * float(end.Get()) for end in (schema(prim).GetLowerLimitAttr(), schema(prim).GetUpperLimitAttr())
    )
    return UrdfJoint(name, kinds[schema], parent, child, T, axis, lower, upper, True, pivot=T_child[:3, 3])


def _read_inertial(prim: Any) -> UrdfInertial:
    mass = UsdPhysics.MassAPI(prim)
    R = _rotation(mass.GetPrincipalAxesAttr().Get())
    tensor = R @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ R.T
    return UrdfInertial(float(mass.GetMassAttr().Get()), np.array(mass.GetCenterOfMassAttr().Get(), float), tensor)


def _rotation(quaternion: Any) -> Array:
    return se3.rotation_from_wxyz([quaternion.GetReal(), *quaternion.GetImaginary()])
