"""Reads and writes asset folders: asset.json, the URDF with its meshes, and effects.json for effects beyond URDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21.asset import Asset
from freeart21.effects import Effect, effect_from_json, effects_from_urdf_dynamics
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.hashes import file_sha256
from freeart21.files.trust_json import trust_from_json, trust_to_json
from freeart21.files.urdf import MAX_URDF_BYTES, UrdfJoint, read_urdf_joints, resolve_mimics
from freeart21.joint import JointType

ASSET_SCHEMA = "freeart21/asset/1"
EFFECTS_SCHEMA = "freeart21/effects/1"
NEUTRAL_BASELINE = {
    "joint_friction": 0.0,
    "link_linear_damping": 0.0,
    "link_angular_damping": 0.0,
    "sleep_threshold": 0.0,
}
"""Effects are relative to a simulator without losses of its own."""


def find_movable_joint(urdf: Path, name: str | None = None) -> UrdfJoint:
    """The joint `name`, or the only movable one; FreeArtError lists the movable joints when the choice is unclear."""
    movable = {j.name: j for j in read_urdf_joints(urdf).values() if j.joint_type}
    if name in movable and (mimic := movable[name].mimic) is not None:
        raise FreeArtError(f"{urdf}: joint '{name}' follows '{mimic[0]}' (mimic), expected one that does not")
    joints = {name: joint for name, joint in movable.items() if joint.mimic is None}
    if not joints:
        raise FreeArtError(f"{urdf} has no movable joint, expected a revolute or prismatic one")
    if name is None and len(joints) == 1:
        return next(iter(joints.values()))
    if name is None or name not in joints:
        wanted = "no joint was named" if name is None else f"it has no movable joint '{name}'"
        kinds = read_semantics(urdf.parent / "semantics.txt")
        raise FreeArtError(
            f"{urdf}: {wanted}; movable joints: {', '.join(_describe_joint(j, kinds) for j in joints.values())}"
        )
    return joints[name]


def held_positions(joints: Mapping[str, UrdfJoint], scored: str) -> dict[str, float]:
    """Positions, rad or m, of all movable joints but `scored`: zero, or the limit nearest to zero.

    A mimic joint is held where its leader puts it while `scored` is at zero.
    """
    free = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in joints.values() if j.joint_type and j.mimic is None}
    full = resolve_mimics(joints, {**free, scored: 0.0})
    return {j.name: full[j.name] for j in joints.values() if j.joint_type and j.name != scored}


def check_no_mimics(urdf: Path, joint: str, what: str) -> None:
    """Raise FreeArtError when joints mimic `joint`, which `what` needs to move one part alone."""
    joints = read_urdf_joints(urdf)
    moved = [resolve_mimics(joints, {joint: q}) for q in (0.0, 1.0)]
    names = [j.name for j in joints.values() if j.joint_type and j.mimic and moved[0][j.name] != moved[1][j.name]]
    if names:
        raise FreeArtError(
            f"{urdf}: joint '{names[0]}' follows '{joint}' (mimic), but {what} moves one part alone; expected a URDF "
            "without <mimic>"
        )


def _describe_joint(joint: UrdfJoint, kinds: dict[str, str]) -> str:
    """A joint for a list of choices, such as 'joint_0 (revolute 0..90 deg, hinge rotation_door)'."""
    per_unit, unit = (np.degrees(1.0), "deg") if joint.joint_type == "revolute" else (1.0, "m")
    if np.isfinite(joint.lower) and np.isfinite(joint.upper):
        span = f" {per_unit * joint.lower + 0.0:.3g}..{per_unit * joint.upper + 0.0:.3g} {unit}"
    else:
        span = " without limits" if joint.type == "continuous" else ""
    kind = f", {kinds[joint.child]}" if joint.child in kinds else ""
    return f"{joint.name} ({joint.type}{span}{kind})"


def read_semantics(path: Path) -> dict[str, str]:
    """Link name to its label in PartNet-Mobility's semantics.txt, such as 'slider drawer'; empty without one."""
    if not path.is_file() or path.stat().st_size > MAX_URDF_BYTES:
        return {}
    rows = (line.split(None, 1) for line in checked.read_text(path, MAX_URDF_BYTES, errors="replace").splitlines())
    return {row[0]: row[1].strip() for row in rows if len(row) == 2}


def write_effects(folder: Path, asset: Asset) -> None:
    """Write effects.json beside the URDF, which must be final: its hash is stored."""
    joints = read_urdf_joints(asset.urdf)
    atomic.write_json(
        folder / "effects.json",
        {
            "schema": EFFECTS_SCHEMA,
            "urdf_sha256": file_sha256(asset.urdf),
            "baseline": NEUTRAL_BASELINE,
            "joints": {
                name: [effect.to_json(_joint_type(joints, name, asset.urdf)) for effect in effects]
                for name, effects in asset.effects.items()
            },
        },
    )


def write_asset_json(folder: Path, asset: Asset) -> None:
    """Write asset.json, and effects.json when there are effects, beside the URDF in `folder`."""
    if any(asset.effects.values()):
        write_effects(folder, asset)
    atomic.write_json(
        folder / "asset.json",
        {
            "schema": ASSET_SCHEMA,
            "urdf": asset.urdf.name,
            "trust": trust_to_json(asset.trust),
            "joint": asset.joint,
            "reference_link": asset.reference_link,
            "moving_link": asset.moving_link,
            "T_canonical_reference": asset.T_canonical_reference,
            "state_zero": asset.state_zero,
            "held": asset.held,
            "scale": asset.scale,
            "source": asset.source,
        },
    )


def read_asset(path: Path, joint: str | None = None, *, guesses: bool = True, root: Path | None = None) -> Asset:
    """The asset in a folder (with asset.json, or with one URDF), or of one URDF file.

    Without asset.json the reference link is the joint's parent, the canonical frame is that link's, and other movable
    joints are held at zero or at the limit nearest to it. Effects come from effects.json or, without one, from the
    URDF's `<dynamics>`; where both exist they must agree.

    Args:
        path: folder or URDF file.
        joint: the joint that is scored; None takes that of asset.json, or the only movable one.
        guesses: False leaves out effects that asset.json marks as guessed (`source.dynamics.guessed`).
        root: folder that bounds the files named by the URDF; None: the folder of asset.json, or `Asset.root`'s default.
    """
    path = Path(path)
    if not path.exists():
        raise FreeArtError(f"{path} does not exist")
    header = path / "asset.json"
    if path.is_dir() and checked.is_there(header):
        asset = _read_asset_json(path, checked.read_json(header, ASSET_SCHEMA), header, joint)
        asset = replace(asset, root=path if root is None else root)
        return asset if guesses or not has_guessed_dynamics(asset) else replace(asset, effects={})
    if path.is_dir():
        urdfs = sorted(path.glob("*.urdf"))
        if len(urdfs) != 1:
            names = ", ".join(p.name for p in urdfs) or "none"
            raise FreeArtError(f"{path} is not an asset: expected asset.json or one URDF, found URDFs: {names}")
        path = checked.require_file(urdfs[0], MAX_URDF_BYTES)
    scored = find_movable_joint(path, joint)
    held = held_positions(read_urdf_joints(path), scored.name)
    return Asset(path, scored.name, scored.parent, scored.child, effects=read_effects(path), held=held, root=root)


def has_guessed_dynamics(asset: Asset) -> bool:
    """Whether asset.json marks the effects as guessed."""
    dynamics = asset.source.get("dynamics")
    return isinstance(dynamics, dict) and dynamics.get("guessed") is True


def read_effects(urdf: Path) -> dict[str, tuple[Effect, ...]]:
    """Joint name to effects, from effects.json beside the URDF, else from its `<dynamics>`."""
    joints = read_urdf_joints(urdf)
    in_urdf = {name: effects_from_urdf_dynamics(j.damping, j.friction) for name, j in joints.items() if j.joint_type}
    path = urdf.parent / "effects.json"
    if not checked.is_there(path):
        return {name: effects for name, effects in in_urdf.items() if effects}
    data = checked.read_json(path, EFFECTS_SCHEMA)
    if data.get("urdf_sha256") != file_sha256(urdf):
        raise FreeArtError(f"{path} was written for another {urdf.name}: its urdf_sha256 does not match")
    entries = data.get("joints")
    if not isinstance(entries, dict) or not all(isinstance(v, list) for v in entries.values()):
        raise FreeArtError(f"{path}: 'joints' must map joint names to lists of effects")
    effects = {}
    for name, listed in entries.items():
        kind = _joint_type(joints, name, path)
        effects[name] = tuple(effect_from_json(entry, kind, f"{path} joint '{name}'") for entry in listed)
    for name, joint in joints.items():
        for attribute, value in (("damping", joint.damping), ("friction", joint.friction)):
            listed_sum = sum(e.urdf_dynamics().get(attribute, 0.0) for e in effects.get(name, ()))
            if joint.joint_type and abs(listed_sum - value) > 1e-9 * max(1.0, abs(value)):
                raise FreeArtError(
                    f"{path}: joint '{name}' has {attribute} {listed_sum:g}, but {urdf.name} has {value:g}"
                )
    return effects


def _read_asset_json(folder: Path, data: dict[str, Any], header: Path, joint: str | None) -> Asset:
    urdf = checked.inside(folder, checked.text(data, "urdf", header))
    scored = find_movable_joint(urdf, joint or checked.text(data, "joint", header))
    held = data.get("held") or {}
    state_zero = data.get("state_zero", 0.0)
    if not isinstance(held, dict) or not all(isinstance(v, int | float) for v in [state_zero, *held.values()]):
        raise FreeArtError(f"{header}: state_zero is {state_zero!r} and held is {held!r}, expected numbers")
    scale = data.get("scale", 1.0)
    if not checked.is_number(scale) or not scale > 0:
        raise FreeArtError(f"{header}: scale is {scale!r}, expected a number above 0")
    return Asset(
        urdf,
        scored.name,
        checked.text(data, "reference_link", header),
        checked.text(data, "moving_link", header),
        checked.numbers(data, "T_canonical_reference", (4, 4), header),
        float(state_zero),
        read_effects(urdf),
        {str(k): float(v) for k, v in held.items()},
        data.get("source") or {},
        float(scale),
        trust_from_json(data.get("trust"), header),
    )


def _joint_type(joints: dict[str, UrdfJoint], name: str, path: Path) -> JointType:
    kind = joints[name].joint_type if name in joints else None
    if kind is None:
        movable = ", ".join(j.name for j in joints.values() if j.joint_type)
        raise FreeArtError(
            f"{path}: effects for joint '{name}', which is not a movable joint of the URDF; movable joints: {movable}"
        )
    return kind
