"""Exports a reconstruction as an asset: URDF, MJCF, USD, meshes, collision shapes, inertia, asset.json,
effects.json."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import freeart21
from export.certificate import MeasuredFiles, certify, list_reloaded, measure_files
from export.checklist import allowed_off, check_asset
from export.collision import Collision, make_collision, separate_collisions
from export.companion_files import write_companion_files
from export.guessed_dynamics import guess_effects
from export.hollows import sealed_faces
from export.inertia import compute_inertial
from export.masses import PartMass, resolve_parts, weigh_parts
from export.materials import DEFAULT, DENSITIES, TABLE
from export.meshes import drop_small_components, write_hull, write_visual
from export.mjcf import format_mjcf
from export.model import AssetModel, LinkModel
from export.parts import Part, WholeParts, close_parts
from export.placement import Placement, place_parts
from export.settings import PRESETS, ExportSettings
from export.splats import PlacedPart, complete_gaussians
from export.urdf import format_urdf
from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.files.certificate import write_certificate
from freeart21.files.gaussians import GAUSSIANS, write_gaussians
from freeart21.files.lock import only_writer
from freeart21.files.places import ASSET, check_place
from freeart21.files.result import read_method, read_result
from freeart21.files.sequence import read_sequence
from freeart21.joint import Joint
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.reconstruction import Failure, Reconstruction, Trust
from freeart21.recording import Recording
from freeart21.se3 import Array
from generator.simulate import joint_motion

URDF, MJCF, MESHES = "object.urdf", "object.xml", "meshes"


DENSITY = DENSITIES[DEFAULT]
"""kg/m^3 by default, that of plastic: video does not show mass."""
_LENGTHS = (1e-3, 10.0)
"""m: bounds of a part's size, its distance from the axis, and its travel. Below 1 mm, collision shapes cannot be made
(`decomposition.MIN_THICKNESS_M`); 10 m, set by hand, is beyond what a depth camera sees."""


def export_result(
    result: Path | Reconstruction,
    out: Path,
    settings: ExportSettings | None = None,
    *,
    effects: tuple[Effect, ...] = (),
    video: Path | None = None,
) -> Asset:
    """Write a result as an asset folder, reload and check it, and return it as read from disk.

    Args:
        result: a result folder, or a reconstruction.
        out: the folder to make. It appears whole or not at all, and replaces an older asset.
        settings: None takes the defaults.
        effects: measured effects of the joint; without any, guessed ones as the settings say.
        video: the sequence folder that was reconstructed, for textures; without it, textures hold the vertex colours.

    Raises FreeArtError on an invalid setting, a failed result, an empty part, lengths out of `_LENGTHS`, a joint that
    does not move, an `out` that is no older asset, and when the asset fails its own check.
    """
    inputs = () if isinstance(result, Reconstruction) else (Path(result),)
    own = (folder for folder in inputs if (folder / "asset").resolve() == Path(out).resolve())
    check_place(out, ASSET, inputs, into=next(own, None))
    settings = settings or ExportSettings()
    settings.check()
    reconstruction, source = _read_reconstruction(result)
    _check_lengths(reconstruction, settings)
    recording = None if video is None else read_sequence(video)
    whole, placement = _complete(reconstruction, recording, settings)
    scaled = scale_reconstruction(reconstruction, settings.scale)
    with only_writer(out), atomic.new_folder(out, ASSET) as folder:
        shapes, penetration, cuts = _make_shapes(whole, placement, settings)
        given = {name: getattr(settings, name) for name in ("mass", "density", "material", "wall")}
        masses = weigh_parts({name: shape.solid for name, shape in shapes.items()}, placement.roles, **given)
        links, parts = _write_links(folder, shapes, masses, placement, settings)
        model = _make_model(links, placement, source.get("sequence"), reconstruction.trust, effects, settings)
        measured = _write_formats(folder, model)
        source |= {
            "parts": {
                name: facts | {"collision": measured.fidelity[links[name].name].to_json()} | masses[name].to_json()
                for name, facts in parts.items()
            },
            **placement.report,
            "penetration": penetration
            | {"deepest_m": measured.contact_depth, "deepest_visual_m": measured.visual_depth}
            | cuts,
            **_describe_settings(settings, guessed=model.effects != effects),
        }
        asset = Asset(
            folder / URDF,
            model.joint.name,
            links["reference"].name,
            links["moving"].name,
            placement.T_canonical_reference,
            placement.state_zero,
            {model.joint.name: model.effects} if model.effects else {},
            source=source,
            scale=settings.scale,
            trust=model.trust,
        )
        write_asset_json(folder, asset)
        if reconstruction.appearance is not None:
            placed = _place_shapes(shapes, placement, scaled.articulation.joint)
            write_gaussians(folder / GAUSSIANS, complete_gaussians(reconstruction.appearance, settings.scale, placed))
        write_companion_files(folder, read_asset(folder), settings.usd)
        write_certificate(folder, replace(certify(read_asset(folder), measured), engines=list_reloaded()))
        _check_written(folder, scaled.articulation.joint, scaled.states, out)
    return read_asset(out)


def _complete(
    reconstruction: Reconstruction,
    recording: Recording | None,
    settings: ExportSettings,
    materials: Mapping[str, str] | None = None,
) -> tuple[WholeParts, Placement]:
    """The whole parts, in lengths of the video, and their place, in those of the asset.

    `materials` are those of the parts; None: as far as the settings tell before the parts have roles. Done again with
    roles where these tell more and walls are as thick as usual for a material.
    """
    scale, given, known = settings.scale, settings.material, materials
    if known is None:
        known = given if isinstance(given, Mapping) else dict.fromkeys(PARTS, given or DEFAULT)
    sizes = {name: scale * bounding_diagonal(reconstruction.articulation.part(name)) for name in PARTS}
    walls = {name: TABLE[known.get(name, DEFAULT)].usual_wall(size) / scale for name, size in sizes.items()}
    choices = settings.placement
    whole = close_parts(reconstruction, recording, settings.meshes, choices.tolerance_m, choices.carve, walls)
    travel = scale if reconstruction.articulation.joint.type == "prismatic" else 1.0
    placement = place_parts(
        scale_reconstruction(whole.reconstruction, scale),
        replace(whole.found, low=travel * whole.found.low, high=travel * whole.found.high),
        choices,
        scale,
        None if recording is None else recording.gravity,
    )
    resolved = resolve_parts(given, placement.roles, "material")
    guessed = (name for name, part in whole.parts.items() if part.panels.get("thickness_by", "rims") != "rims")
    if materials is None and any(known.get(name, DEFAULT) != resolved.get(name, DEFAULT) for name in guessed):
        return _complete(reconstruction, recording, settings, resolved)
    return whole, placement


def _check_written(folder: Path, joint: Joint, states: Array, out: Path) -> None:
    """Raise FreeArtError when the asset in `folder` breaks a rule, or its joint moves otherwise than `joint`, the
    reconstruction's, in its range of `states` (n,), in the canonical frame."""
    failed = f"the asset for {out} does not pass its own check"
    if findings := check_asset(folder):
        raise FreeArtError(f"{failed}: {findings[0]}")
    asset, sampled = read_asset(folder), np.linspace(states.min(), states.max(), 7)
    motion = joint_motion(replace(asset, effects={}), sampled)  # kinematic effects change the motion
    error = float(np.abs(motion - joint.transform(sampled)).max())
    expected = 2 * allowed_off(asset.T_canonical_reference, motion)
    if error > expected:
        raise FreeArtError(
            f"{failed}: its joint is {error:.2g} from the reconstruction's, expected at most {expected:g}"
        )


def _read_reconstruction(result: Path | Reconstruction) -> tuple[Reconstruction, dict[str, Any]]:
    """The reconstruction, and its method and sequence for asset.json."""
    if isinstance(result, Reconstruction):
        return result, {}
    folder = Path(result)
    answer = read_result(folder)
    if isinstance(answer, Failure):
        raise FreeArtError(f"{folder} is a failure, nothing to export: {answer.stage}: {answer.reason}")
    path = folder.resolve()
    return answer, {"method": read_method(path.parent).name, "sequence": path.name}


def _check_lengths(reconstruction: Reconstruction, settings: ExportSettings) -> None:
    """Raise FreeArtError when a part's size, its distance from the axis or its travel is not within `_LENGTHS`."""
    whole, joint = reconstruction.articulation, reconstruction.articulation.joint
    low, high = _LENGTHS
    expected = f"expected {1000 * low:g} mm to {high:g} m: surfaces, depth or scale are wrong"
    for name in PARTS:
        part = drop_small_components(whole.part(name))
        if not part.areas().sum() > 0:
            continue  # reported by `close_parts`
        size = settings.scale * bounding_diagonal(part)
        if not low <= size <= high:
            raise FreeArtError(f"{name} part is {size:.3g} m large, {expected}")
        arm = settings.scale * float(np.linalg.norm(np.cross(joint.axis, box_centre(part) - joint.pivot)))
        if joint.type == "revolute" and arm > high:
            raise FreeArtError(f"{name} part lies {arm:.3g} m from the axis of joint '{joint.name}', {expected}")
    travel = settings.scale * float(np.ptp(reconstruction.states))
    if joint.type == "prismatic" and travel > high:
        raise FreeArtError(f"joint '{joint.name}' travels {travel:.3g} m, {expected}")


def scale_reconstruction(reconstruction: Reconstruction, scale: float) -> Reconstruction:
    """The reconstruction with all lengths of parts and joint, and the travel of a prismatic joint, times `scale`.

    Camera poses stay as they are, so they no longer fit the scaled object.
    """
    if scale == 1.0:
        return reconstruction
    whole, joint = reconstruction.articulation, reconstruction.articulation.joint
    travel = scale if joint.type == "prismatic" else 1.0
    return replace(
        reconstruction,
        articulation=replace(
            whole,
            joint=replace(joint, pivot=scale * joint.pivot, lower=travel * joint.lower, upper=travel * joint.upper),
            reference=replace(whole.reference, vertices=scale * whole.reference.vertices),
            moving=replace(whole.moving, vertices=scale * whole.moving.vertices),
        ),
        states=travel * reconstruction.states,
    )


@dataclass(frozen=True)
class _Shape:
    """One part: its meshes and its collision shapes."""

    part: Part
    solid: Mesh
    """Closed, with the walls of cavities that nothing connects with the outside: what the mass is computed of."""
    visual: Mesh
    """Without these walls."""
    collision: Collision


def _make_shapes(
    whole: WholeParts, placement: Placement, settings: ExportSettings
) -> tuple[dict[str, _Shape], dict[str, Any], dict[str, Any]]:
    """The parts' shapes, their collision shapes cut where they overlap more than the tolerance; for asset.json, how
    deep the parts were in each other, in lengths of the asset, and the counts of cuts.

    No collision shape is cut when the parts themselves overlap.
    """
    with ThreadPoolExecutor() as pool:  # most of the time goes into nearest-point queries, which release the GIL
        made = pool.map(lambda name: _make_shape(name, whole.parts[name], placement, settings), whole.parts)
        shapes = dict(zip(whole.parts, made, strict=True))
    tolerance = settings.placement.tolerance_m * settings.scale
    found = {
        key: settings.scale ** {"carved_m3": 3}.get(key, 1) * value if isinstance(value, float) else value
        for key, value in whole.penetration.items()
    } | {"tolerance_m": tolerance}
    if not settings.placement.carve or (found["before_carving_m"] > tolerance and found["carved"] is None):
        return shapes, found, {}
    collisions = {name: shape.collision for name, shape in shapes.items()}
    separated, counts = separate_collisions(collisions, placement.joint, placement.root, tolerance)
    return {name: replace(shapes[name], collision=separated[name]) for name in shapes}, found, {"pieces": counts}


def _make_shape(name: str, part: Part, placement: Placement, settings: ExportSettings) -> _Shape:
    solid = getattr(placement, name)
    sealed = sealed_faces(solid)
    visual = solid.with_faces(~sealed)
    ground = 0.0 if name == placement.root else -float(placement.joint.pivot[2])  # in its link's frame
    try:
        collision = make_collision(
            visual, settings.collision or PRESETS[settings.contact], ground, single=not part.surface.is_solid
        )
        compute_inertial(solid, 1.0, settings.wall)  # raises without a volume
    except FreeArtError as error:
        raise FreeArtError(f"{name} part: {error}") from error
    return _Shape(part.without(sealed), solid, visual, collision)


def _place_shapes(shapes: dict[str, _Shape], placement: Placement, joint: Joint) -> dict[str, PlacedPart]:
    """The parts where they stand at joint position zero; `joint` is the canonical one, in lengths of the asset."""
    to_child = se3.pose(np.eye(3), placement.joint.pivot)
    Ts_link = {name: np.eye(4) if name == placement.root else to_child for name in PARTS}
    T_root_canonical = Ts_link["reference"] @ se3.inverse(placement.T_canonical_reference)
    motions = {"reference": np.eye(4), "moving": joint.transform(-placement.state_zero)}
    return {
        name: PlacedPart(shape.part, shape.visual, Ts_link[name], T_root_canonical @ motions[name])
        for name, shape in shapes.items()
    }


def _write_links(
    folder: Path,
    shapes: dict[str, _Shape],
    masses: dict[str, PartMass],
    placement: Placement,
    settings: ExportSettings,
) -> tuple[dict[str, LinkModel], dict[str, dict[str, Any]]]:
    """Write the meshes of the parts; their links, and their facts for asset.json."""
    links, facts = {}, {}
    for name, shape in shapes.items():
        visual, collision, mass = shape.visual, shape.collision, masses[name]
        texture = write_visual(folder / MESHES, name, visual, shape.part.texture)
        hulls = tuple(f"{MESHES}/{name}_hull_{k:02d}.obj" for k in range(len(collision.hulls)))
        for file, hull in zip(hulls, collision.hulls, strict=True):
            write_hull(folder / file, hull)
        links[name] = LinkModel(
            placement.roles[name] if settings.names == "role" else name,
            f"{MESHES}/{name}.obj",
            texture and f"{MESHES}/{texture}",
            hulls,
            compute_inertial(shape.solid, mass.density, settings.wall),
            collision.primitives,
            TABLE[mass.material],
        )
        counts = {"hulls": len(hulls), "primitives": len(collision.primitives), "role": placement.roles[name]}
        facts[name] = shape.part.to_json(settings.scale) | counts
    return links, facts


def _make_model(
    links: dict[str, LinkModel],
    placement: Placement,
    name: Any,
    trust: Trust | None,
    effects: tuple[Effect, ...],
    settings: ExportSettings,
) -> AssetModel:
    """The asset as it is written to each format; with guessed effects where there are none and the settings say so."""
    root, child = (links[part] for part in sorted(PARTS, key=lambda part: part != placement.root))
    joint = replace(placement.joint, name=_identifier(placement.joint.name, "joint"))
    if not effects and settings.dynamics == "guessed":  # the origin of the child link is the pivot
        effects = guess_effects(replace(joint, pivot=np.zeros(3)), child.inertial)
    title = _identifier(str(name or "object"), "object")
    return AssetModel(title, root, child, joint, settings.effort, settings.velocity, effects, settings.base, trust)


def _write_formats(folder: Path, model: AssetModel) -> MeasuredFiles:
    """Write URDF and MJCF, and measure what they consist of."""
    atomic.write_bytes(folder / URDF, format_urdf(model))
    atomic.write_bytes(folder / MJCF, format_mjcf(model))
    return measure_files(folder / URDF, model.joint.name)


def _describe_settings(settings: ExportSettings, guessed: bool) -> dict[str, Any]:
    """For asset.json: what the masses were computed of, whether effects are `guessed`, the exporter and settings."""
    of = "the solid that the mesh bounds" if settings.wall is None else "a wall along the mesh"
    return {
        "mass": {"of": of, "wall_m": settings.wall},
        "dynamics": {"guessed": guessed},
        "length_unit": "m",
        "exporter": f"freeart21 {freeart21.__version__}",
        "settings": dataclasses.asdict(settings),
    }


def _identifier(text: str, fallback: str) -> str:
    """`text` as a name of letters, digits and underscores, valid in every format."""
    return re.sub(r"[^0-9A-Za-z_]+", "_", text).strip("_") or fallback
