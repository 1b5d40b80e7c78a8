"""A reconstruction becomes an asset: URDF and MJCF, meshes, hulls, inertia, asset.json, effects.json; then a check."""

from __future__ import annotations

import dataclasses
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import freeart21
from export.beside import USD, write_beside
from export.checklist import FK_TOLERANCE, check_asset
from export.collision import Collision, CollisionSettings, convex_parts, kept_apart
from export.delivered import contact_depth, contact_fidelity, delivered_shapes
from export.guessed_dynamics import DYNAMICS, Dynamics, guessed_effects
from export.inertia import inertial_of
from export.joint_range import STATES
from export.materials import DEFAULT, DENSITIES, MATERIALS, Material
from export.meshes import MeshSettings, without_crumbs, write_hull, write_visual
from export.mjcf import mjcf_text
from export.model import BASES, AssetModel, Base, LinkModel
from export.parts import Part, closed_parts
from export.placement import Placement, PlacementSettings, placed
from export.urdf import urdf_text
from export.usd_reload import usd_findings
from freeart21.articulation import PARTS
from freeart21.asset import Asset
from freeart21.effects.base import Effect
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.files.lock import only_writer
from freeart21.files.places import ASSET, check_place
from freeart21.files.result import read_method, read_result
from freeart21.files.sequence import read_sequence
from freeart21.mesh import Mesh, bounding_diagonal, box_centre
from freeart21.reconstruction import Failure, Reconstruction
from generator.simulate import joint_motion

URDF, MJCF, MESHES = "object.urdf", "object.xml", "meshes"


DENSITY = DENSITIES[DEFAULT]
"""kg/m^3 when nobody says, as of plastic: video tells no mass."""
_DENSITIES = (1e-3, 1e5)
"""kg/m^3 of matter on earth, with room."""
_MASSES = (1e-6, 1e6)
"""kg that single precision and the engines bear."""
_WALLS = (1e-5, 1.0)
"""m, from foil to masonry."""
_SCALES = (1e-4, 1e4)
_LENGTHS = (1e-3, 10.0)
"""m of a part, of the way to its axis and of its travel. Less than the collision shapes' least thickness has no shape;
beyond 8.4 m single precision misses the poses of other engines by `checklist.FK_TOLERANCE`."""


@dataclass(frozen=True)
class ExportSettings:
    """How a reconstruction is written as an asset."""

    density: float | None = None
    """kg/m^3 of both parts; None is that of `material`, unless `mass` is given."""
    material: Material | None = None
    """What both parts are made of, one of `export.materials.MATERIALS`; None is a guess, `DEFAULT`."""
    wall: float | None = None
    """m: both parts are hollow, with walls this thick along their surface; None takes the solids that meshes bound."""
    mass: float | None = None
    """kg of the whole object, which the parts share by the volumes of their solids or walls; not together with
    `density`."""
    dynamics: Dynamics = "guessed"
    """Whether a joint without effects gets a little damping and friction, marked as guessed."""
    scale: float = 1.0
    """Lengths of the asset (meshes, pivot, travel, T_canonical_reference) over those of the video."""
    placement: PlacementSettings = field(default_factory=PlacementSettings)
    """Which way is up, where the joint is at zero, and where it ends."""
    min_range_rad: float = 1e-3
    """A revolute joint that was seen to move less has no limits to export."""
    min_range_m: float = 1e-4
    """The same for a prismatic joint."""
    effort: float = 100.0
    """URDF effort limit, N*m or N: video tells none."""
    velocity: float = 10.0
    """URDF velocity limit, rad/s or m/s: video tells none."""
    base: Base = "free"
    """Whether the part that carries moves freely, as a thing in the hand, or stands fixed in the world: a free one can
    be fixed by whoever loads it."""
    usd: bool | None = None
    """Whether a USD is written; None where usd-core is installed."""
    meshes: MeshSettings = field(default_factory=MeshSettings)
    """Part meshes and their textures."""
    collision: CollisionSettings = field(default_factory=CollisionSettings)
    """Collision hulls."""

    def check(self) -> None:
        """FreeArtError when a number cannot be."""
        if self.base not in BASES:
            raise FreeArtError(f"base is '{self.base}', expected {' or '.join(BASES)}")
        if self.density is not None and self.mass is not None:
            raise FreeArtError(f"density {self.density:g} kg/m^3 and mass {self.mass:g} kg: give one of them")
        self.placement.check()
        for name, known in (("material", MATERIALS), ("dynamics", DYNAMICS)):
            if getattr(self, name) not in (None, *known):
                raise FreeArtError(f"there is no {name} '{getattr(self, name)}'; there are {', '.join(known)}")
        for name, unit, (low, high) in (
            ("density", " kg/m^3", _DENSITIES),
            ("wall", " m", _WALLS),
            ("mass", " kg", _MASSES),
            ("scale", "", _SCALES),
        ):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise FreeArtError(f"{name} is {value:g}{unit}, expected {low:g} to {high:g}")


def export_result(
    result: Path | Reconstruction,
    out: Path,
    settings: ExportSettings | None = None,
    *,
    effects: tuple[Effect, ...] = (),
    video: Path | None = None,
) -> Asset:
    """Write a result as an asset folder, reload and check it, and give it back as read from disk.

    Args:
        result: a result folder, or a reconstruction.
        out: the folder to make; it appears whole or not at all, and replaces an older asset.
        settings: None takes the defaults.
        effects: what was measured to act on the joint; without any it gets guessed ones, or none, as settings say.
        video: the sequence folder that was reconstructed: textures come from its sharpest frames. Without it they hold
            the colours of the part meshes' vertices.

    Raises FreeArtError on a setting that cannot be, a failed result, a part that is empty, smaller than 1 mm or larger
    than 10 m or as far from its axis, a joint that was not seen to move,
    an `out` that is anything but an older asset, and when the asset does not pass its own check.
    """
    given = () if isinstance(result, Reconstruction) else (Path(result),)
    own = (folder for folder in given if (folder / "asset").resolve() == Path(out).resolve())
    check_place(out, ASSET, given, into=next(own, None))
    settings = settings or ExportSettings()
    settings.check()
    reconstruction, source = _reconstruction(result)
    _check_lengths(reconstruction, settings)
    recording = None if video is None else read_sequence(video)
    reconstruction, parts = closed_parts(reconstruction, recording, settings.meshes)
    placement = placed(
        scaled(reconstruction, settings.scale),
        settings.placement,
        {"revolute": settings.min_range_rad, "prismatic": settings.min_range_m * settings.scale},
        settings.scale,
        {name: part.surface.observed for name, part in parts.items()},
        [name for name, part in parts.items() if not part.surface.is_solid],
    )
    with only_writer(out), atomic.new_folder(out, ASSET) as aside:
        with ThreadPoolExecutor() as pool:  # most of it looks up nearest points, which threads do at once
            tasks = {name: pool.submit(_shape, name, part, placement, settings) for name, part in parts.items()}
        shapes = {name: task.result() for name, task in tasks.items()}
        shapes, said_apart = _apart(shapes, placement, settings)
        density = DENSITIES[settings.material or DEFAULT] if settings.density is None else settings.density
        if settings.mass is not None:
            density = settings.mass / sum(
                inertial_of(shape.solid, 1.0, settings.wall).mass for shape in shapes.values()
            )
        written = {name: _write_link(aside, name, shape, density, settings) for name, shape in shapes.items()}
        root, child = (written[name][0] for name in sorted(PARTS, key=lambda name: name != placement.root))
        joint = replace(placement.joint, name=_word(placement.joint.name, "joint"))
        guessed = not effects and settings.dynamics == "guessed"
        if guessed:  # the child link's frame stands at the pivot
            effects = guessed_effects(replace(joint, pivot=np.zeros(3)), child.inertial)
        model = AssetModel(
            _word(str(source.get("sequence") or "object"), "object"),
            root,
            child,
            joint,
            settings.effort,
            settings.velocity,
            effects,
            settings.base,
            reconstruction.trust,
        )
        atomic.write_bytes(aside / URDF, urdf_text(model))
        atomic.write_bytes(aside / MJCF, mjcf_text(model))
        seen, touched = delivered_shapes(aside / URDF)
        fidelity = contact_fidelity(seen, touched)
        depth = contact_depth(aside / URDF, joint.name, touched, STATES)
        source |= {
            "parts": {name: said | {"collision": fidelity[name].said()} for name, (_, said) in written.items()},
            **placement.said,
            "penetration": placement.said["penetration"] | {"deepest_m": depth} | said_apart,
            "mass": _said_of_mass(settings, density, placement.said["penetration"]["carved"]),
            "dynamics": {"guessed": guessed},
            "length_unit": "m",
            "exporter": f"freeart21 {freeart21.__version__}",
            "settings": dataclasses.asdict(settings),
        }
        write_asset_json(aside, _asset(aside, model, placement, source, settings.scale))
        write_beside(aside, read_asset(aside), settings.usd)
        findings = check_asset(aside)
        if (aside / USD).is_file():
            findings += usd_findings(aside / USD, read_asset(aside))
        if findings:
            raise FreeArtError(f"the asset for {out} does not pass its own check: {findings[0]}")
        _check_motion(read_asset(aside), scaled(reconstruction, settings.scale), out)
    return read_asset(out)


def _check_motion(asset: Asset, reconstruction: Reconstruction, out: Path) -> None:
    """FreeArtError when the reloaded asset does not move in the canonical frame as the reconstruction's joint does."""
    states, joint = reconstruction.states, reconstruction.articulation.joint
    asked = np.linspace(states.min(), states.max(), 7)
    moved = joint_motion(replace(asset, effects={}), asked)  # kinematic effects go beyond the reconstruction
    off = float(np.abs(moved - joint.transform(asked)).max())
    if off > 2 * FK_TOLERANCE:
        raise FreeArtError(
            f"the asset for {out} does not pass its own check: its joint is {off:.2g} from the reconstruction's, "
            f"expected at most {2 * FK_TOLERANCE:g}"
        )


def _reconstruction(result: Path | Reconstruction) -> tuple[Reconstruction, dict[str, Any]]:
    """The reconstruction, and where it came from."""
    if isinstance(result, Reconstruction):
        return result, {}
    folder = Path(result)
    read = read_result(folder, appearance=False)
    if isinstance(read, Failure):
        raise FreeArtError(f"{folder} is a failure, nothing to export: {read.stage}: {read.reason}")
    place = folder.resolve()
    return read, {"method": read_method(place.parent).name, "sequence": place.name}


def _check_lengths(reconstruction: Reconstruction, settings: ExportSettings) -> None:
    """FreeArtError when a part, the way from it to the joint's axis, or its travel is of no length of `_LENGTHS`."""
    whole, joint = reconstruction.articulation, reconstruction.articulation.joint
    low, high = _LENGTHS
    expected = f"expected {1000 * low:g} mm to {high:g} m: surfaces, depth or scale are wrong"
    for name in PARTS:
        part = without_crumbs(whole.part(name), settings.meshes.min_component)
        if not part.areas().sum() > 0:
            continue  # nothing to export, which is said elsewhere
        size = settings.scale * bounding_diagonal(part)
        if not low <= size <= high:
            raise FreeArtError(f"{name} part is {size:.3g} m large, {expected}")
        arm = settings.scale * float(np.linalg.norm(np.cross(joint.axis, box_centre(part) - joint.pivot)))
        if joint.type == "revolute" and arm > high:
            raise FreeArtError(f"{name} part lies {arm:.3g} m from the axis of joint '{joint.name}', {expected}")
    travel = settings.scale * float(np.ptp(reconstruction.states))
    if joint.type == "prismatic" and travel > high:
        raise FreeArtError(f"joint '{joint.name}' travels {travel:.3g} m, {expected}")


def scaled(reconstruction: Reconstruction, scale: float) -> Reconstruction:
    """The reconstruction with the lengths of its parts and joint, and travel of a prismatic one, times `scale`.

    What was seen in the camera stays: its poses are then of another object, and no longer fit.
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
    """A part for the eye and for contact."""

    part: Part
    visual: Mesh
    solid: Mesh
    """The visual mesh without what would be in the other part."""
    collision: Collision


def _shape(name: str, part: Part, placement: Placement, settings: ExportSettings) -> _Shape:
    visual, solid = getattr(placement, name), placement.solids[name]
    ground = 0.0 if name == placement.root else -float(placement.joint.pivot[2])  # in its link's frame
    try:
        collision = convex_parts(solid, settings.collision, ground, whole=not part.surface.is_solid)
        shape = _Shape(part, visual, solid, collision)
        inertial_of(solid, 1.0, settings.wall)  # there is a volume
    except FreeArtError as error:
        raise FreeArtError(f"{name} part: {error}") from error
    return shape


def _apart(
    shapes: dict[str, _Shape], placement: Placement, settings: ExportSettings
) -> tuple[dict[str, _Shape], dict[str, Any]]:
    """The shapes with pieces that are no deeper in each other than the parts may be, where the parts are clear of each
    other themselves; for asset.json, how many pieces that took."""
    tolerance, said = settings.placement.tolerance_m * settings.scale, placement.said["penetration"]
    if not settings.placement.carve or (said["deepest_m"] > tolerance and said["carved"] is None):
        return shapes, {}
    collisions = {name: shape.collision for name, shape in shapes.items()}
    found, counts = kept_apart(collisions, placement.joint, placement.root, tolerance, settings.collision)
    return {name: replace(shapes[name], collision=found[name]) for name in shapes}, {"pieces": counts}


def _write_link(
    folder: Path, name: str, shape: _Shape, density: float, settings: ExportSettings
) -> tuple[LinkModel, dict[str, Any]]:
    """Write the meshes of one link; also what asset.json says about them."""
    visual, collision = shape.visual, shape.collision
    texture = write_visual(folder / MESHES, name, visual, shape.part.skin)
    hulls = tuple(f"{MESHES}/{name}_hull_{k:02d}.obj" for k in range(len(collision.hulls)))
    for file, hull in zip(hulls, collision.hulls, strict=True):
        write_hull(folder / file, hull)
    said = {
        **shape.part.said(settings.scale),
        "hulls": len(hulls),
        "primitives": len(collision.primitives),
    }
    inertial = inertial_of(shape.solid, density, settings.wall)
    visual_file, picture = f"{MESHES}/{name}.obj", texture and f"{MESHES}/{texture}"
    return LinkModel(name, visual_file, picture, hulls, inertial, collision.primitives), said


def _said_of_mass(settings: ExportSettings, density: float, carved: str | None) -> dict[str, Any]:
    """How masses came about: who gave what, and what is a guess."""
    given = settings.mass is not None or settings.density is not None
    less = "" if carved is None else f", less what was carved of the {carved} part"
    return {
        "by": "given mass" if settings.mass is not None else "density",
        "density": density,
        "material": None if given else settings.material or DEFAULT,
        "of": f"{'the solid that the mesh bounds' if settings.wall is None else 'a wall along the mesh'}{less}",
        "wall_m": settings.wall,
        "guessed": not given and settings.material is None,
    }


def _asset(folder: Path, model: AssetModel, placement: Placement, source: dict[str, Any], scale: float) -> Asset:
    return Asset(
        folder / URDF,
        model.joint.name,
        "reference",
        "moving",
        placement.T_canonical_reference,
        placement.state_zero,
        {model.joint.name: model.effects} if model.effects else {},
        {},
        source,
        scale,
        model.trust,
    )


def _word(text: str, fallback: str) -> str:
    """`text` as a name that every format takes: letters, digits, underscores."""
    return re.sub(r"[^0-9A-Za-z_]+", "_", text).strip("_") or fallback
