"""A reconstruction becomes an asset: URDF and MJCF, meshes, hulls, inertia, asset.json, effects.json; then a check."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import freeart21
from export.checklist import check_asset
from export.collision import CollisionSettings, convex_parts
from export.inertia import inertial_of
from export.meshes import MeshSettings, cleaned, inside_out, turned, write_hull, write_visual
from export.mjcf import mjcf_text
from export.model import AssetModel, LinkModel
from export.placement import Placement, placed
from export.urdf import urdf_text
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.files.lock import only_writer
from freeart21.files.places import ASSET, check_place
from freeart21.files.result import read_method, read_result
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction

URDF, MJCF, MESHES = "object.urdf", "object.xml", "meshes"


@dataclass(frozen=True)
class ExportSettings:
    """How a reconstruction is written as an asset."""

    density: float = 600.0
    """kg/m^3 of the collision hulls, as of wood: video tells no mass."""
    up: tuple[float, float, float] = (0.0, -1.0, 0.0)
    """Direction in the canonical frame that becomes z of the links: ours is a camera frame, whose y points down."""
    limit_margin: float = 0.02
    """Fraction of the observed range by which each joint limit lies beyond it."""
    min_range_rad: float = 1e-3
    """A revolute joint that was seen to move less has no limits to export."""
    min_range_m: float = 1e-4
    """The same for a prismatic joint."""
    effort: float = 100.0
    """URDF effort limit, N*m or N: video tells none."""
    velocity: float = 10.0
    """URDF velocity limit, rad/s or m/s: video tells none."""
    meshes: MeshSettings = field(default_factory=MeshSettings)
    """Visual meshes."""
    collision: CollisionSettings = field(default_factory=CollisionSettings)
    """Collision hulls."""


def export_result(
    result: Path | Reconstruction,
    out: Path,
    settings: ExportSettings | None = None,
    *,
    effects: tuple[Effect, ...] = (),
) -> Asset:
    """Write a result as an asset folder, reload and check it, and give it back as read from disk.

    Args:
        result: a result folder, or a reconstruction.
        out: the folder to make; it appears whole or not at all, and replaces an older asset.
        settings: None takes the defaults.
        effects: what acts on the joint; without any there is no effects.json.

    Raises FreeArtError on a failed result, an empty part, a joint that was not seen to move, an `out` that is anything
    but an older asset, and when the asset does not pass its own check.
    """
    given = () if isinstance(result, Reconstruction) else (Path(result),)
    own = (folder for folder in given if (folder / "asset").resolve() == Path(out).resolve())
    check_place(out, ASSET, given, into=next(own, None))
    settings = settings or ExportSettings()
    reconstruction, source = _reconstruction(result)
    placement = placed(
        reconstruction,
        settings.up,
        settings.limit_margin,
        {"revolute": settings.min_range_rad, "prismatic": settings.min_range_m},
    )
    with only_writer(out), atomic.new_folder(out, ASSET) as aside:
        reference, said_reference = _write_link(aside, "reference", placement.reference, settings)
        moving, said_moving = _write_link(aside, "moving", placement.moving, settings)
        joint = replace(placement.joint, name=_word(placement.joint.name, "joint"))
        model = AssetModel(
            _word(str(source.get("sequence") or "object"), "object"),
            reference,
            moving,
            joint,
            settings.effort,
            settings.velocity,
            effects,
        )
        atomic.write_bytes(aside / URDF, urdf_text(model))
        atomic.write_bytes(aside / MJCF, mjcf_text(model))
        source |= {
            "parts": {"reference": said_reference, "moving": said_moving},
            "up": "z",
            "length_unit": "m",
            "exporter": f"freeart21 {freeart21.__version__}",
            "settings": dataclasses.asdict(settings),
        }
        write_asset_json(aside, _asset(aside, model, placement, source))
        findings = check_asset(aside)
        if findings:
            raise FreeArtError(f"the asset for {out} does not pass its own check: {findings[0]}")
    return read_asset(out)


def _reconstruction(result: Path | Reconstruction) -> tuple[Reconstruction, dict[str, Any]]:
    """The reconstruction, and where it came from."""
    if isinstance(result, Reconstruction):
        return result, {}
    folder = Path(result)
    read = read_result(folder)
    if isinstance(read, Failure):
        raise FreeArtError(f"{folder} is a failure, nothing to export: {read.stage}: {read.reason}")
    place = folder.resolve()
    return read, {"method": read_method(place.parent).name, "sequence": place.name}


def _write_link(folder: Path, name: str, part: Mesh, settings: ExportSettings) -> tuple[LinkModel, dict[str, Any]]:
    """Write the meshes of one link; also what asset.json says about them."""
    try:
        visual = cleaned(part, settings.meshes)
        wrong_way = inside_out(visual)
        visual = turned(visual) if wrong_way else visual
        collision = convex_parts(visual, settings.collision)
        inertial = inertial_of(collision.hulls, settings.density)
    except FreeArtError as error:
        raise FreeArtError(f"{name} part: {error}") from error
    texture = write_visual(folder / MESHES, name, visual, settings.meshes)
    hulls = tuple(f"{MESHES}/{name}_hull_{k:02d}.obj" for k in range(len(collision.hulls)))
    for file, hull in zip(hulls, collision.hulls, strict=True):
        write_hull(folder / file, hull)
    said = {
        "faces_before": len(part.faces),
        "faces": len(visual.faces),
        "faces_turned_outwards": wrong_way,
        "collision": collision.method,
        "hulls": len(hulls),
        "collision_fallback_reason": collision.reason,
    }
    return LinkModel(name, f"{MESHES}/{name}.obj", texture and f"{MESHES}/{texture}", hulls, inertial), said


def _asset(folder: Path, model: AssetModel, placement: Placement, source: dict[str, Any]) -> Asset:
    return Asset(
        folder / URDF,
        model.joint.name,
        model.reference.name,
        model.moving.name,
        placement.T_canonical_reference,
        placement.state_zero,
        {model.joint.name: model.effects} if model.effects else {},
        {},
        source,
    )


def _word(text: str, fallback: str) -> str:
    """`text` as a name that every format takes: letters, digits, underscores."""
    return re.sub(r"[^0-9A-Za-z_]+", "_", text).strip("_") or fallback
