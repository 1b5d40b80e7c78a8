"""Both parts of a reconstruction as closed surfaces with textures, in the canonical frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from export.atlas import Texture
from export.carving import SIMPLIFY_SHARE, carve_overlap, cut_spots
from export.free_space import find_free_space
from export.hollows import Panels, find_panels, sealed_faces
from export.joint_range import STATES, JointRange, estimate_joint_range
from export.meshes import flip_faces
from export.penetration import Overlap
from export.settings import TOLERANCE, MeshSettings
from export.surface import Surface, close_surface, replace_mesh, subtract_cavities
from export.texture import check_recording, texture_from_vertices, textures_from_video
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Recording

_SMOOTH_VOXELS = 0.2
"""Voxels by which a cavity's walls may move to save triangles: 0.6 mm in a drawer unit."""


@dataclass(frozen=True)
class Part:
    """A closed part and its texture."""

    surface: Surface
    texture: Texture | None
    """None: grey."""
    texture_source: str | None
    """'video' or 'vertex colours'; None without a texture."""
    faces_before: int
    """Triangles of the reconstructed mesh."""
    panels: dict[str, Any]
    """What was found of panels and hollow cores (`export.hollows`), in lengths of the video."""

    def without(self, faces: NDArray[np.bool_]) -> Part:
        """The part without some of its triangles, flags (F,)."""
        texture = self.texture
        if texture is not None:
            texture = replace(texture, atlas=replace(texture.atlas, corners=texture.atlas.corners[~faces]))
        return replace(self, surface=self.surface.without(faces), texture=texture)

    def to_json(self, scale: float) -> dict[str, Any]:
        """The part's entry in asset.json; lengths times `scale`."""
        surface = self.surface
        return {
            "faces_before": self.faces_before,
            "faces": len(surface.mesh.faces),
            "faces_turned_outwards": surface.flipped,
            "layers": round(surface.layers, 3),
            "solid": surface.is_solid,
            "supposed_share": round(surface.patch_share, 4),
            "patch": {
                "first_face": surface.patch_first,
                "faces": surface.patch_count,
                "symmetric_faces": surface.symmetric_count,
                "panel_faces": surface.panel_count,
                "area_fraction": surface.patch_share,
            },
            "panels": self.panels,
            "texture": self.texture_source,
            "texel_m": None if self.texture is None else scale * self.texture.atlas.texel_m,
        }


@dataclass(frozen=True)
class WholeParts:
    """Both parts, whole and clear of each other."""

    reconstruction: Reconstruction
    """With closed parts."""
    parts: dict[str, Part]
    found: JointRange
    """The joint's range, rad or m, in lengths of the video."""
    penetration: dict[str, Any]
    """For asset.json, in lengths of the video: how deep the parts are in each other, and what was carved."""


def close_parts(
    reconstruction: Reconstruction,
    recording: Recording | None,
    settings: MeshSettings,
    tolerance: float = TOLERANCE,
    carve: bool = True,
    walls: Mapping[str, float] | None = None,
) -> WholeParts:
    """The parts of a reconstruction, closed, hollow where they are, clear of each other over the joint's range, and
    textured from the recording or, without one, from vertex colours.

    Where they overlap by more than `tolerance`, m, and `carve` is set, one of them loses what the other sweeps. `walls`
    are the usual thicknesses, m, by part, of walls whose rims were not seen.

    Raises FreeArtError, which names the part, when one cannot be closed.
    """
    whole = reconstruction.articulation
    for name in PARTS:
        if whole.part(name).empty:
            raise FreeArtError(f"{name} part of joint '{whole.joint.name}' is an empty mesh: nothing to export")
        if not whole.part(name).areas().sum() > 0:
            raise FreeArtError(f"{name} part: mesh has no triangle of any area")
    if recording is not None:
        check_recording(reconstruction, recording)
    surfaces, panels = {}, {}
    for name in PARTS:
        try:
            space = find_free_space(reconstruction, name, recording)
            closed = close_surface(whole.part(name), settings, space)
        except FreeArtError as error:
            raise FreeArtError(f"{name} part: {error}") from error
        found = Panels()
        if closed.patch_count and closed.is_solid:
            found = find_panels(closed.mesh, closed.observed, space, (walls or {}).get(name, np.inf))
            closed = subtract_cavities(closed, found.cavities, _SMOOTH_VOXELS * space.voxel, settings)
        surfaces[name], panels[name] = closed, found.report
    surfaces, range_, penetration = clear_parts(reconstruction, surfaces, settings, tolerance, carve)
    meshes = (surfaces["reference"].mesh, surfaces["moving"].mesh)
    if recording is not None:
        textures: tuple[Texture | None, ...] = textures_from_video(
            reconstruction, meshes, recording, (surfaces["reference"].supposed, surfaces["moving"].supposed)
        )
    else:
        textures = tuple(
            texture_from_vertices(mesh, whole.part(name)) for name, mesh in zip(PARTS, meshes, strict=True)
        )
    origin = "vertex colours" if recording is None else "video"
    parts = {
        name: Part(
            surfaces[name], texture, None if texture is None else origin, len(whole.part(name).faces), panels[name]
        )
        for name, texture in zip(PARTS, textures, strict=True)
    }
    articulation = replace(whole, reference=meshes[0], moving=meshes[1])
    return WholeParts(replace(reconstruction, articulation=articulation), parts, range_, penetration)


def clear_parts(
    reconstruction: Reconstruction, surfaces: dict[str, Surface], settings: MeshSettings, tolerance: float, carve: bool
) -> tuple[dict[str, Surface], JointRange, dict[str, Any]]:
    """The surfaces, one of them carved where they overlap by more than `tolerance`, m, in the joint's range; the range;
    and a report. A sealed hollow counts as solid: nothing gets into it."""
    hollow, sealed = dict(surfaces), {name: sealed_faces(surface.mesh) for name, surface in surfaces.items()}
    surfaces = {name: surface.without(sealed[name]) for name, surface in surfaces.items()}
    closed = replace(reconstruction.articulation, reference=surfaces["reference"].mesh, moving=surfaces["moving"].mesh)
    overlap = Overlap(closed)
    touching = Overlap(closed, {name: surface.observed for name, surface in surfaces.items()})
    found = estimate_joint_range(replace(reconstruction, articulation=closed), touching, tolerance)
    not_solid = [name for name, surface in surfaces.items() if not surface.is_solid]
    cut, report = carve_parts(closed, found, tolerance, carve, not_solid, overlap)
    if report["carved"] is not None:
        surfaces = {
            name: replace_mesh(surface, cut.part(name), tolerance, settings) for name, surface in surfaces.items()
        }
        name = report["carved"]
        simple = replace(cut, reference=surfaces["reference"].mesh, moving=surfaces["moving"].mesh)
        mesh = cut_spots(simple, name, np.linspace(found.low, found.high, STATES), tolerance)
        surfaces[name] = replace_mesh(surfaces[name], mesh, tolerance, replace(settings, max_faces=len(mesh.faces)))
        for name, surface in surfaces.items():
            cavity = flip_faces(hollow[name].mesh.with_faces(sealed[name]))
            limits = replace(settings, max_faces=len(surface.mesh.faces) + len(cavity.faces))
            hollow[name] = subtract_cavities(surface, [cavity], SIMPLIFY_SHARE * tolerance, limits)
    return hollow, found, report


def carve_parts(
    parts: Articulation,
    found: JointRange,
    tolerance: float,
    carve: bool = True,
    not_solid: Sequence[str] = (),
    overlap: Overlap | None = None,
) -> tuple[Articulation, dict[str, Any]]:
    """The closed parts, one of them carved where they overlap by more than `tolerance`, m, in the range; and a report
    of the depth before, what was carved, or why nothing was."""
    overlap = Overlap(parts) if overlap is None else overlap
    before = overlap.max_depth(np.linspace(found.low, found.high, STATES))
    report: dict[str, Any] = {"before_carving_m": before, "carved": None}
    if before <= tolerance or not carve:
        return parts, report
    if not_solid:
        return parts, report | {"not_carved_because": f"the {not_solid[0]} part is no solid"}
    cut = carve_overlap(parts, found.low, found.high, tolerance, overlap)
    if isinstance(cut, str):
        return parts, report | {"not_carved_because": cut}
    reference, moving = (cut.mesh, cut.other) if cut.name == "reference" else (cut.other, cut.mesh)
    return replace(parts, reference=reference, moving=moving), report | {
        "carved": cut.name,
        "carved_m3": cut.volume,
    }
