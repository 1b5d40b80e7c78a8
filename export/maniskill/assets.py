"""Objects for the environments: a name in the catalog, a folder, or a URDF, at any scale."""

from __future__ import annotations

import contextlib
import os
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21 import catalog, se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import read_asset
from freeart21.files.urdf import Urdf, UrdfInertial, UrdfShape, format_urdf, read_urdf
from freeart21.files.urdf_files import find_file
from freeart21.reconstruction import describe_trust
from freeart21.se3 import Array
from generator.object_folder import object_folder, sapien_urdf

PARTNET = "mobility.urdf"
_SCALES = (1e-4, 1e4)


def objects_place() -> Path:
    """Cache folder of procedural objects: $XDG_CACHE_HOME/freeart21/objects, or ~/.cache/freeart21/objects."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "freeart21" / "objects"


def find_asset(asset: str | Path, joint: str | None = None, object_seed: int = 0) -> Asset:
    """The asset that `asset` names.

    Args:
        asset: an asset folder (asset.json), a PartNet-Mobility folder (mobility.urdf), a URDF, a folder with one, or a
            procedural object of the catalog, made from `object_seed` in `objects_place()`.
        joint: the joint that moves; None takes the folder's choice, or the only movable one.
        object_seed: sizes and colours of a procedural object.

    Warns about an asset whose reconstruction is doubtful. Raises FreeArtError when there is none, or its joint is
    unclear.
    """
    path = Path(asset)
    if not path.exists():
        if str(asset) not in catalog.built_in_names():
            raise FreeArtError(
                f"asset '{asset}' is neither a file or folder nor an object of the catalog: "
                f"{', '.join(catalog.built_in_names())}"
            )
        path = object_folder(str(asset), object_seed, objects_place())
    if (path / PARTNET).is_file() and not (path / "asset.json").is_file():
        return read_asset(path / PARTNET, joint or _find_scored_joint(path))
    found = read_asset(path, joint)
    if found.trust is not None and found.trust.verdict == "doubtful":
        warnings.warn(f"{path} was made of a reconstruction that is {describe_trust(found.trust)}", stacklevel=2)
    return found


def _find_scored_joint(folder: Path) -> str | None:
    """The scored joint of a PartNet-Mobility folder, from our meta.json or the catalog."""
    meta = folder / "meta.json"
    scored = checked.read_json(meta).get("scored_joint") if meta.is_file() else None
    known = next((entry.joint for entry in catalog.CATALOG if entry.name == folder.resolve().name), None)
    return scored if isinstance(scored, str) else known


@contextlib.contextmanager
def prepare_asset(asset: Asset, scale: float) -> Iterator[Asset]:
    """`asset` in a form that SAPIEN loads with textures, at `scale` times its lengths; valid inside the `with`.

    Masses scale with scale^3, moments of inertia with scale^5. Raises FreeArtError for an asset with effects at another
    scale than 1: they were measured at its own size.
    """
    if not _SCALES[0] <= scale <= _SCALES[1]:
        raise FreeArtError(f"scale is {scale:g}, expected {_SCALES[0]:g} to {_SCALES[1]:g}")
    if scale != 1 and any(asset.effects.values()):
        raise FreeArtError(
            f"{asset.urdf} has effects, which hold for its own size only: expected scale 1, got {scale:g}"
        )
    with sapien_urdf(asset.urdf, asset.root) as readable, tempfile.TemporaryDirectory() as place:
        if scale == 1:
            yield replace(asset, urdf=readable, root=Path(readable.anchor))
            return
        urdf = Path(place) / asset.urdf.name
        urdf.write_bytes(format_urdf(_scale_urdf(readable, scale)))
        T = asset.T_canonical_reference.copy()
        T[:3, 3] *= scale
        travel = _travel(readable, scale)
        held = {name: q * travel.get(name, 1.0) for name, q in asset.held.items()}
        zero = asset.state_zero * travel.get(asset.joint, 1.0)
        yield replace(asset, urdf=urdf, root=Path(urdf.anchor), T_canonical_reference=T, state_zero=zero, held=held)


def _travel(urdf: Path, scale: float) -> dict[str, float]:
    """Joint name to `scale`, for prismatic joints."""
    return {joint.name: scale for joint in read_urdf(urdf).joints.values() if joint.type == "prismatic"}


def _scale_urdf(path: Path, scale: float) -> Urdf:
    def scaled_pose(T: Array) -> Array:
        return se3.pose(T[:3, :3], scale * T[:3, 3])

    def scaled_shape(_: str, shape: UrdfShape) -> UrdfShape:
        file = str(find_file(path, shape.filename, Path(path.anchor))) if shape.filename else ""
        return replace(shape, T_link_shape=scaled_pose(shape.T_link_shape), size=scale * shape.size, filename=file)

    urdf = read_urdf(path).with_shapes(scaled_shape)
    links, joints = {}, {}
    for name, link in urdf.links.items():
        of = link.inertial
        scaled = of and UrdfInertial(scale**3 * of.mass, scale * of.centre, scale**5 * of.inertia)
        links[name] = replace(link, inertial=scaled)
    for name, joint in urdf.joints.items():
        factor = scale if joint.type == "prismatic" else 1.0
        ends = factor * joint.lower, factor * joint.upper
        joints[name] = replace(joint, T_parent_joint=scaled_pose(joint.T_parent_joint), lower=ends[0], upper=ends[1])
    return replace(urdf, links=links, joints=joints)


def joint_span(lower: float, upper: float, prismatic: bool) -> tuple[float, float]:
    """Range of a joint's targets: its limits; half a turn or 0.1 m either way where it has none."""
    free = 0.1 if prismatic else float(np.pi)
    return (lower if np.isfinite(lower) else -free), (upper if np.isfinite(upper) else free)
