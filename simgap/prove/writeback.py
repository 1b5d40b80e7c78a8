"""Effects written into a copy of the asset: URDF and MJCF as far as they can express them, effects.json fully."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from export.companion_files import write_companion_files
from export.loaders import FOLDER as LOADERS
from export.mjcf import STIFF_FRICTION, joint_attributes, urdf_to_mjcf
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.files.asset_copy import copy_asset_files, mjcf_path, set_dynamics, set_mjcf_joint, write_xml
from generator import simulate
from simgap.prove.body import NO_CORRECTION, BodyCorrection, check_body, correct_body

_POSE_TOLERANCE = 1e-6  # metres and rotation entries; the engine has single precision


def write_repaired(
    asset: Asset,
    effects: tuple[Effect, ...],
    folder: Path,
    source: dict[str, Any] | None = None,
    body: BodyCorrection = NO_CORRECTION,
) -> Asset:
    """Write a copy of the asset with `effects` added to its joint's into `folder`, and return it as reloaded.

    Args:
        asset: unchanged.
        effects: added; those of a kind that the asset has are merged with it.
        folder: for the files; must be empty or new.
        source: provenance of the repair, for asset.json.
        body: correction of inertia and weight beyond the joint.

    Raises FreeArtError when the joint cannot have an effect, a referenced file cannot be copied, or the reloaded asset
    differs in more than its effects.
    """
    effects = (*effects, *body.offset)
    merged = {**asset.effects, asset.joint: merge_effects(asset.effects.get(asset.joint, ()), effects)}
    files = copy_asset_files(asset.urdf, folder, asset.root)
    urdf, mjcf = folder / asset.urdf.name, mjcf_path(asset.urdf)
    correct_body(files[urdf.name], asset, body)
    set_dynamics(files[urdf.name], {name: _sum_dynamics(acting) for name, acting in merged.items()})
    write_xml(urdf, files[urdf.name])
    keeps_mjcf = mjcf.name in files and body == NO_CORRECTION  # else it is converted from the corrected URDF
    if keeps_mjcf:
        unset = ("damping", "frictionloss", *STIFF_FRICTION, "armature", "stiffness", "springref")
        words = joint_attributes(merged.get(asset.joint, ()), asset.joint)
        set_mjcf_joint(files[mjcf.name], asset.joint, unset, words, mjcf)
        write_xml(folder / mjcf.name, files[mjcf.name])
    source_json = {key: value for key, value in asset.source.items() if key != "dynamics"}  # measured now, not guessed
    source_json |= {"repair": source} if source else {}
    repaired = replace(asset, urdf=urdf, effects=merged, source=source_json, root=folder)
    if not keeps_mjcf:
        atomic.write_bytes(folder / mjcf.name, urdf_to_mjcf(repaired))
    write_asset_json(folder, repaired)
    if (asset.urdf.parent / LOADERS).is_dir():  # our exporter's assets contain effects in more files
        write_companion_files(folder, repaired)
    read = _check_reloaded(asset, merged, folder)
    if body != NO_CORRECTION:
        check_body(asset, read, body, folder)
    return read


def merge_effects(had: tuple[Effect, ...], new: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """The effects of both, merged where that is possible (`Effect.merge`)."""
    out = list(had)
    for effect in new:
        same = next((i for i, e in enumerate(out) if e.name == effect.name), None)
        both = None if same is None else out[same].merge(effect)
        if same is None or both is None:
            out.append(effect)
        else:
            out[same] = both
    return tuple(out)


def _sum_dynamics(effects: tuple[Effect, ...]) -> dict[str, float]:
    """Damping and friction that effects add up to in a URDF."""
    terms = [effect.urdf_dynamics() for effect in effects]
    return {word: float(np.sum([t.get(word, 0.0) for t in terms])) for word in ("damping", "friction")}


def _check_reloaded(asset: Asset, effects: dict[str, tuple[Effect, ...]], folder: Path) -> Asset:
    """The asset as read from `folder`, after checking its effects and its joint."""
    read = read_asset(folder)
    if read.effects != {name: acting for name, acting in effects.items() if acting}:
        raise FreeArtError(f"{folder} has effects {read.effects} once reloaded, expected {effects}")
    states = np.array([-0.3, 0.0, 0.4])
    plain = (replace(a, effects={}) for a in (asset, read))
    before, after = (simulate.joint_motion(a, states) for a in plain)
    off = float(np.abs(before - after).max())
    if off > _POSE_TOLERANCE:
        raise FreeArtError(f"{folder} moves its joint {off:.2g} from where the asset did, expected the same")
    return read
