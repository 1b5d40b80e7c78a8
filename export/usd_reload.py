"""Checks an asset's USD layer against its URDF: read back by usd-core and compared number by number."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from export.checklist import Finding, allowed_off
from export.model import WORLD
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.urdf import Urdf, UrdfInertial, UrdfJoint, read_urdf
from freeart21.se3 import Array

RULE = "usd.same"
MAX_USD_BYTES = 512 << 20
"""Of a layer: two meshes of the largest size (`checklist.MAX_MESH_BYTES`)."""
_SINGLE = 1e-5
"""Relative difference of masses, moments and limits. USD stores them in single precision (6e-8), moments about
principal axes: 5,000 random tensors came back within 2e-7. A wrong unit or axis differs by far more."""


def check_usd(path: Path, asset: Asset) -> Iterator[Finding]:
    """Differences between the USD layer at `path` and the asset's URDF in bodies, masses and joints.

    Needs usd-core. A layer that references other layers is refused: no other file is opened.
    """
    from pxr import Sdf, Tf, Usd, UsdGeom, UsdPhysics

    try:
        file = str(checked.require_file(path, MAX_USD_BYTES))
        layer = Sdf.Layer.OpenAsAnonymous(file)
        others = layer.GetCompositionAssetDependencies()
        stage = None if others else Usd.Stage.Open(layer)
    except (FreeArtError, Tf.ErrorException) as error:
        yield Finding(RULE, f"{path.name} cannot be read: {(str(error).strip().splitlines() or [''])[-1]}")
        return
    if stage is None:
        yield Finding(RULE, f"{path.name} names {sorted(others)[0]}, expected a layer of its own")
        return
    units = (UsdGeom.GetStageMetersPerUnit(stage), UsdPhysics.GetStageKilogramsPerUnit(stage))
    up = str(UsdGeom.GetStageUpAxis(stage))
    if units != (1.0, 1.0) or up != "Z":
        found_units = f"{path.name} counts in {units[0]:g} m and {units[1]:g} kg with {up} up"
        yield Finding(RULE, f"{found_units}, expected 1 m, 1 kg and Z")
        return
    urdf = read_urdf(asset.urdf)
    prims = {str(prim.GetName()): prim for prim in stage.Traverse()}
    links = {str(Tf.MakeValidIdentifier(name)): name for name in urdf.links if not name == WORLD == urdf.root}
    joints = {str(Tf.MakeValidIdentifier(name)): name for name in urdf.joints}
    for kind, names, schema in (
        ("body", links, lambda prim: prim.HasAPI(UsdPhysics.RigidBodyAPI)),
        ("joint", joints, lambda prim: prim.IsA(UsdPhysics.Joint)),
    ):
        found = {name for name, prim in prims.items() if schema(prim)}
        for name in sorted(found ^ set(names)):
            lacks = "has no" if name in names else "has another"
            yield Finding(RULE, f"{path.name} {lacks} {kind} '{names.get(name, name)}'")
        if found != set(names):
            return
    poses = urdf.link_poses(asset.held)
    for prim_name, name in links.items():
        yield from _check_body(path, prims[prim_name], name, poses[name], urdf.links[name].inertial)
    for prim_name, name in joints.items():
        yield from _check_joint(path, prims[prim_name], urdf.joints[name], urdf)


def _check_body(path: Path, prim: Any, name: str, T: Array, inertial: UrdfInertial | None) -> Iterator[Finding]:
    from pxr import UsdGeom, UsdPhysics

    T_usd = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)).T
    off = float(np.abs(T_usd - T).max())
    if not off <= allowed_off(T):
        yield Finding(RULE, f"{path.name} puts '{name}' {off:.2g} from its pose in the URDF")
    if inertial is None:
        return
    mass = UsdPhysics.MassAPI(prim)
    R = _rotation(mass.GetPrincipalAxesAttr().Get())
    for what, found, expected in (
        ("mass", mass.GetMassAttr().Get(), inertial.mass),
        ("centre of mass", mass.GetCenterOfMassAttr().Get(), inertial.centre),
        ("inertia", R @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ R.T, inertial.inertia),
    ):
        if not np.abs(np.asarray(found) - expected).max() <= _SINGLE * max(np.abs(expected).max(), 1e-12):
            yield Finding(RULE, f"{path.name} gives '{name}' the {what} {_text(found)}, the URDF {_text(expected)}")


def _check_joint(path: Path, prim: Any, joint: UrdfJoint, urdf: Urdf) -> Iterator[Finding]:
    from pxr import Tf, UsdPhysics

    kinds = {"revolute": UsdPhysics.RevoluteJoint, "prismatic": UsdPhysics.PrismaticJoint, None: UsdPhysics.FixedJoint}
    schema = kinds[joint.joint_type](prim)
    if not schema:
        yield Finding(RULE, f"{path.name} has joint '{joint.name}' as {prim.GetTypeName()}, the URDF as {joint.type}")
        return
    for link, relation in ((joint.parent, schema.GetBody0Rel()), (joint.child, schema.GetBody1Rel())):
        targets = [target.name for target in relation.GetTargets()]
        if targets != ([] if link == WORLD == urdf.root else [str(Tf.MakeValidIdentifier(link))]):
            yield Finding(RULE, f"{path.name} has joint '{joint.name}' on {targets}, the URDF on '{link}'")
    frames = [
        se3.pose(_rotation(rotation.Get()), np.array(place.Get(), float))
        for place, rotation in (
            (schema.GetLocalPos0Attr(), schema.GetLocalRot0Attr()),
            (schema.GetLocalPos1Attr(), schema.GetLocalRot1Attr()),
        )
    ]
    screw = np.zeros(6)
    if joint.joint_type is not None:
        turns = joint.joint_type == "revolute"
        screw["XYZ".index(str(schema.GetAxisAttr().Get())) + 3 * turns] = 1.0
        ends = (schema.GetLowerLimitAttr().Get(), schema.GetUpperLimitAttr().Get())
        found = np.radians(ends) if turns else np.array(ends)
        expected = np.array([joint.lower, joint.upper])
        bounded = np.isfinite(expected)
        off = np.abs(found - expected)[bounded] > _SINGLE * np.maximum(np.abs(expected[bounded]), 1.0)
        if off.any() or np.isfinite(found[~bounded]).any():
            yield Finding(
                RULE, f"{path.name} limits joint '{joint.name}' to {_text(found)}, the URDF to {_text(expected)}"
            )
    positions = (
        np.linspace(joint.lower, joint.upper, 3) if np.isfinite([joint.lower, joint.upper]).all() else [0.0, 1.0]
    )
    moved = np.stack([frames[0] @ se3.exp_se3(q * screw) @ se3.inverse(frames[1]) for q in positions])
    off_by = float(np.abs(moved - np.stack([joint.transform(float(q)) for q in positions])).max())
    if not off_by <= allowed_off(moved):
        yield Finding(RULE, f"{path.name} moves joint '{joint.name}' to {off_by:.2g} from its pose in the URDF")


def _rotation(quaternion: Any) -> Array:
    return se3.rotation_from_wxyz([quaternion.GetReal(), *quaternion.GetImaginary()])


def _text(values: Any) -> str:
    return np.array2string(np.asarray(values, float), precision=6, separator=" ").replace("\n", "")
