"""Both parts of a reconstruction as closed surfaces with textures, in the canonical frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from export.atlas import Texture
from export.free_space import find_free_space
from export.hollows import Panels, find_panels
from export.meshes import MeshSettings
from export.surface import Surface, close_surface, subtract_cavities
from export.texture import check_recording, texture_from_vertices, textures_from_video
from freeart21.articulation import PARTS
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
                "panel_faces": surface.panel_count,
                "area_fraction": surface.patch_share,
            },
            "panels": self.panels,
            "texture": self.texture_source,
            "texel_m": None if self.texture is None else scale * self.texture.atlas.texel_m,
        }


def close_parts(
    reconstruction: Reconstruction, recording: Recording | None, settings: MeshSettings
) -> tuple[Reconstruction, dict[str, Part]]:
    """The reconstruction with closed parts, and the parts by name, textured from the recording or, without one, from
    vertex colours.

    Raises FreeArtError, which names the part, when one cannot be closed.
    """
    whole = reconstruction.articulation
    for name in PARTS:
        if whole.part(name).empty:
            raise FreeArtError(f"{name} part of joint '{whole.joint.name}' is an empty mesh: nothing to export")
    if recording is not None:
        check_recording(reconstruction, recording)
    surfaces, panels = [], []
    for name in PARTS:
        try:
            space = find_free_space(reconstruction, name, recording)
            closed = close_surface(whole.part(name), settings, space)
        except FreeArtError as error:
            raise FreeArtError(f"{name} part: {error}") from error
        found = Panels()
        if closed.patch_count and closed.is_solid:
            found = find_panels(closed.mesh, closed.observed, space)
            closed = subtract_cavities(closed, found.cavities, _SMOOTH_VOXELS * space.voxel, settings)
        surfaces.append(closed)
        panels.append(found.report)
    meshes = (surfaces[0].mesh, surfaces[1].mesh)
    if recording is not None:
        textures: tuple[Texture | None, ...] = textures_from_video(reconstruction, meshes, recording)
    else:
        textures = tuple(
            texture_from_vertices(mesh, whole.part(name)) for name, mesh in zip(PARTS, meshes, strict=True)
        )
    origin = "vertex colours" if recording is None else "video"
    parts = {
        name: Part(surface, texture, None if texture is None else origin, len(whole.part(name).faces), report)
        for name, surface, texture, report in zip(PARTS, surfaces, textures, panels, strict=True)
    }
    articulation = replace(whole, reference=meshes[0], moving=meshes[1])
    return replace(reconstruction, articulation=articulation), parts
