"""Both parts of a reconstruction as closed surfaces with textures, still in the canonical frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from export.atlas import Skin
from export.meshes import MeshSettings, inside_out, smooth_normals
from export.surface import Surface, closed
from export.texture import vertex_skin, video_skins
from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.mesh import bounding_diagonal
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Recording

_SWEEP_STATES = 60
"""States between the outermost ones at which the other part's surface is taken to be elsewhere."""
_SWEEP_DEPTH = 200.0
"""Parts of a part's diagonal by which each of three layers of these points lies below the last."""
_SWEEP_POINTS = 10_000
"""Points of the other part's surface at each of them, at most."""


@dataclass(frozen=True)
class Part:
    """A closed part and what it wears."""

    surface: Surface
    skin: Skin | None
    """None is grey."""
    texture_of: str | None
    """What the skin is made of: 'video' or 'vertex colours'; None without a skin."""
    faces_before: int
    """Triangles that the reconstruction had."""

    def said(self, scale: float) -> dict[str, Any]:
        """What asset.json says about the part's mesh; lengths times `scale`, areas fractions."""
        surface = self.surface
        return {
            "faces_before": self.faces_before,
            "faces": len(surface.mesh.faces),
            "faces_turned_outwards": surface.turned,
            "layers": round(surface.layers, 3),
            "solid": surface.is_solid,
            "patch": {
                "first_face": surface.patch_first,
                "faces": surface.patch_count,
                "area_fraction": surface.patch_share,
            },
            "texture": self.texture_of,
            "texel_m": None if self.skin is None else scale * self.skin.atlas.texel_m,
        }


def closed_parts(
    reconstruction: Reconstruction, recording: Recording | None, settings: MeshSettings
) -> tuple[Reconstruction, dict[str, Part]]:
    """The reconstruction with closed parts, and these by name, textured from the recording when there is one.

    Raises FreeArtError, naming the part, when one cannot be closed.
    """
    whole = reconstruction.articulation
    for name in PARTS:
        if whole.part(name).empty:
            raise FreeArtError(f"{name} part of joint '{whole.joint.name}' is an empty mesh: nothing to export")
    surfaces = []
    for name in PARTS:
        try:
            surfaces.append(closed(whole.part(name), settings, _other_part(reconstruction, name)))
        except FreeArtError as error:
            raise FreeArtError(f"{name} part: {error}") from error
    meshes = (surfaces[0].mesh, surfaces[1].mesh)
    if recording is not None:
        skins: tuple[Skin | None, ...] = video_skins(reconstruction, meshes, recording, settings.video_frames)
    else:
        skins = tuple(vertex_skin(mesh, whole.part(name)) for name, mesh in zip(PARTS, meshes, strict=True))
    origin = "vertex colours" if recording is None else "video"
    parts = {
        name: Part(surface, skin, None if skin is None else origin, len(whole.part(name).faces))
        for name, surface, skin in zip(PARTS, surfaces, skins, strict=True)
    }
    articulation = replace(whole, reference=meshes[0], moving=meshes[1])
    return replace(reconstruction, articulation=articulation), parts


def _other_part(reconstruction: Reconstruction, name: str) -> NDArray[np.float64]:
    """(n, 3) where the other part was, just below its surface, in part `name`'s frame, at states over all believed:
    those of frames that hid a part are predicted, and the joint's range holds them, too."""
    whole = reconstruction.articulation
    other = whole.part("moving" if name == "reference" else "reference")
    few = slice(None, None, len(other.vertices) // _SWEEP_POINTS + 1)
    depth = bounding_diagonal(whole.part(name)) / _SWEEP_DEPTH * np.arange(3)[:, None, None]
    depth = -depth if inside_out(other) else depth
    points = (other.vertices[few] - depth * smooth_normals(other)[few]).reshape(-1, 3)
    states = reconstruction.states
    Ts = whole.joint.transform(np.linspace(states.min(), states.max(), _SWEEP_STATES))
    Ts = Ts if name == "reference" else se3.inverse(Ts)
    return np.concatenate([se3.transform(T, points) for T in Ts])
