"""The whole object as Gaussians: those that a method fitted to the video, and discs on the faces that nobody saw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from export.meshes import GREY
from export.parts import Part
from freeart21.files.gaussians import MAX_GAUSSIANS
from freeart21.gaussians import Gaussians, face_along
from freeart21.mesh import Mesh, triangle_normals
from freeart21.se3 import Array

_RADIUS, _THICKNESS = 0.6, 0.1
"""Standard deviations of a disc, in distances between neighbours, and along its normal, in radii: as fitting begins
with (`reconstruct.gaussians.initial`)."""
_OPACITY = 0.95
"""Set by hand, not measured: fitting begins with .7 and makes Gaussians denser, which it cannot do here."""


@dataclass(frozen=True)
class PlacedPart:
    """A part in its asset, at joint position zero."""

    part: Part
    mesh: Mesh
    """Visual mesh in its link's frame; triangles as the part's."""
    T_root_link: Array
    """(4, 4) its link's frame in the root link's."""
    T_root_canonical: Array
    """(4, 4) the canonical frame in the root link's, as this part moves; lengths of the asset."""


def complete_gaussians(seen: Gaussians, scale: float, parts: Mapping[str, PlacedPart]) -> Gaussians:
    """Gaussians of the whole object in its root link's frame at joint position zero, supposed ones marked.

    On the triangles that nobody saw there are discs in the mesh's colours, as dense as the seen Gaussians are wide.
    Seen ones belong wholly to the part that they belong to more, as the joint need not be at its canonical zero.

    Args:
        seen: of a result, in its canonical frame.
        scale: lengths of the asset over those of the video.
        parts: 'reference' and 'moving'.
    """
    owners = seen.part_weights >= 0.5
    seen = replace(
        seen,
        means=scale * seen.means,
        scales=scale * seen.scales,
        opacities=seen.opacities * np.maximum(seen.part_weights, 1 - seen.part_weights),
        part_weights=owners.astype(np.float32),
        supposed=np.zeros(len(seen), bool),
    )
    area = sum(float(placed.mesh.areas()[placed.part.surface.patch_first :].sum()) for placed in parts.values())
    least = float(np.sqrt(area / max(MAX_GAUSSIANS - len(seen) - len(parts), 1)))
    wide = float(np.median(np.sort(seen.scales, axis=1)[:, 1:])) if len(seen) else 0.0
    whole = []
    for name, placed in parts.items():
        reference = name == "reference"
        whole.append(seen.chosen(owners == reference).moved(placed.T_root_canonical))
        whole.append(_cover(placed, max(wide / _RADIUS, least), reference).moved(placed.T_root_link))
    names = ("means", "quaternions", "scales", "opacities", "colours", "part_weights", "normals", "supposed")
    joined = {name: np.concatenate([getattr(some, name) for some in whole]) for name in names}
    return Gaussians(**joined, light=seen.light)


def _cover(placed: PlacedPart, spacing: float, reference: bool) -> Gaussians:
    """Discs about `spacing`, m, apart on the triangles of a part that nobody saw, in its link's frame."""
    mesh, first = placed.mesh, placed.part.surface.patch_first
    areas = mesh.areas()[first:]
    count = round(float(areas.sum()) / spacing**2)
    k = np.arange(count)
    ends = np.cumsum(areas)
    face = first + np.minimum(np.searchsorted(ends, (k + 0.5) / max(count, 1) * areas.sum()), len(areas) - 1)
    u, v = np.modf(0.7548776662466927 * k)[0], np.modf(0.5698402909980532 * k)[0]  # R2 sequence (Roberts 2018)
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    mix, corners = np.stack([1 - u - v, u, v], 1), mesh.faces[face]
    normals = triangle_normals(mesh.vertices, mesh.faces[face])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    colours, texture = np.tile(GREY, (count, 1)), placed.part.texture
    if texture is not None and count:
        at = np.einsum("nk,nki->ni", mix, texture.atlas.pixels[texture.atlas.corners[face]])
        column, row = np.clip(at.astype(int), 0, [texture.atlas.width - 1, texture.atlas.height - 1]).T
        colours = texture.image[row, column] / 255
    arrays = (
        np.einsum("nk,nki->ni", mix, mesh.vertices[corners]),
        face_along(normals),
        np.tile(_RADIUS * spacing * np.array([1, 1, _THICKNESS]), (count, 1)),
        np.full(count, _OPACITY),
        colours,
        np.full(count, reference),
        normals,
    )
    return Gaussians(*(a.astype(np.float32) for a in arrays), supposed=np.ones(count, bool))
