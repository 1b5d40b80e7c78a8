"""The truth of a third-party recording: from its own files, with the meshes of its PartNet-Mobility object."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21 import catalog
from freeart21.errors import FreeArtError
from freeart21.formats.third_party import KnownTruth, ThirdPartyRecording, safe_name
from freeart21.joint import Joint
from freeart21.mesh import bounding_diagonal
from freeart21.truth import Truth
from generator import partnet
from generator.object_source import find_partnet_folder
from generator.truth_mesh import build_truth
from generator.urdf_object import LoadedObject

EDGE = 0.02
"""Longest edge of the truth meshes, as a share of the object's diagonal: as in recordings of our own."""
VISIBLE_EVERY = 3

_SAME_AXIS_DEGREES = 1.0
_SAME_PLACE = 0.01  # of the diagonal
_SAME_STATE = 1e-3


def complete_truth(
    read: ThirdPartyRecording, partnet_root: Path, joint: str | None = None, skip_missing: bool = False
) -> Truth:
    """The truth of `read`, with meshes from partnet_root/ID (or partnet_root/dataset/ID) and no held-out views.

    The joint is the given one, or that of the layout or the catalog, or the only movable one. Raises FreeArtError when
    the object is absent or unfit, or differs from the one that was filmed: another joint axis, or other positions of
    the joints that are held.
    """
    known = read.known
    if known is None:
        raise FreeArtError(read.lacks)
    folder = find_partnet_folder(safe_name(read.object_id), partnet_root)
    named = joint or known.joint_name
    if named is None:
        named = next((entry.joint for entry in catalog.CATALOG if entry.name == read.object_id), None)
    loaded = partnet.load(folder, named, skip_missing)
    coarse = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
    diagonal = bounding_diagonal(*coarse)
    _check_same(read, known, loaded, diagonal)
    parts = known.parts(loaded.joint)
    fine = [side.surface.subdivided(EDGE * diagonal).mesh() for side in loaded.sides]
    links = [side.links for side in loaded.sides]
    facts = {
        "object": read.object_id,
        "category": loaded.category,
        "object_source": "partnet",
        "joint": loaded.joint.name,
        "held": loaded.asset.held,
        "reference_links": links[parts.order[0]],
        "moving_links": links[parts.order[1]],
    }
    frames = range(0, len(known.states), VISIBLE_EVERY)
    return build_truth(fine, parts, known.states, read.recording.camera, frames, known.source | facts)


def _check_same(read: ThirdPartyRecording, known: KnownTruth, loaded: LoadedObject, diagonal: float) -> None:
    wrong = sorted(n for n, q in known.held.items() if abs(loaded.asset.held.get(n, q) - q) > _SAME_STATE)
    if wrong:
        name = wrong[0]
        raise FreeArtError(
            f"{read.name}: joint '{name}' stood at {known.held[name]:.3g}, but the object is loaded with it at "
            f"{loaded.asset.held[name]:.3g}"
        )
    if known.joint is not None:
        fault = _difference(known.joint, loaded.joint, diagonal)
        if fault:
            raise FreeArtError(f"{loaded.name}: its {loaded.joint.name} is not the joint of {read.name}: {fault}")


def _difference(seen: Joint, urdf: Joint, diagonal: float) -> str:
    """The difference between the joint of the recorded poses and the URDF's, in words; empty for none."""
    if seen.type != urdf.type:
        return f"{seen.type} in the recording, {urdf.type} in the URDF"
    angle = float(np.degrees(np.arccos(np.clip(seen.axis @ urdf.axis, -1, 1))))
    if angle > _SAME_AXIS_DEGREES:
        return f"the axes are {angle:.1f} deg apart"
    apart = float(np.linalg.norm(np.cross(seen.pivot - urdf.pivot, urdf.axis)))
    if seen.type == "revolute" and apart > _SAME_PLACE * diagonal:
        return f"the axes are {apart:.3g} apart, with a diagonal of {diagonal:.3g}"
    return ""
