"""Initial Gaussians: discs on the fused surfaces of both parts."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from reconstruct.gaussians.model import Parameters, logit
from reconstruct.settings import GaussianSettings
from reconstruct.surfaces import vertex_normals

THICKNESS = 0.1
"""Of a disc, in radii."""
OPACITY = 0.7
PART_WEIGHT = 0.97
"""Initial part weight of Gaussians on the reference part; one minus it on the moving part."""
SPACING = 1.25
"""Smallest mean distance between neighbours, footprints."""
RADIUS = 0.6
"""Standard deviation of a disc, in mean distances between neighbours."""


def place_discs(
    meshes: tuple[Mesh, Mesh], footprint: float, settings: GaussianSettings, rng: np.random.Generator
) -> Parameters:
    """Gaussians on the meshes of reference and moving part, canonical frame: SPACING times `footprint`, metres, apart.

    Fewer where that would be more than `settings.begin`.
    """
    areas = [float(mesh.areas().sum()) for mesh in meshes]
    spacing = max(SPACING * footprint, float(np.sqrt(sum(areas) / settings.begin)))
    means, normals, colours = ([np.zeros((0, 3))] for _ in range(3))
    weights = [np.zeros(0)]
    for part, (mesh, area) in enumerate(zip(meshes, areas, strict=True)):
        count = round(area / spacing**2)
        if mesh.empty or count == 0:
            continue
        share = mesh.areas()
        # stratified by area: fewer doubles and holes than independent draws
        at = (np.arange(count) + rng.random(count)) / count * share.sum()
        face = np.minimum(np.searchsorted(np.cumsum(share), at), len(share) - 1)
        u, v = rng.random(count), rng.random(count)
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        corners = mesh.faces[face]
        mix = np.stack([1 - u - v, u, v], 1)
        means.append(np.einsum("nk,nkd->nd", mix, mesh.vertices[corners]))
        normal = np.einsum("nk,nkd->nd", mix, vertex_normals(mesh.vertices, mesh.faces)[corners])
        normals.append(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))
        palette = np.full((len(mesh.vertices), 3), 128, np.uint8) if mesh.colours is None else mesh.colours
        colours.append(np.einsum("nk,nkd->nd", mix, palette[corners]) / 255)
        weights.append(np.full(count, PART_WEIGHT if part == 0 else 1 - PART_WEIGHT))
    n = sum(map(len, means))
    light = np.zeros((settings.light_terms, 3), np.float32)
    light[0] = 1 / 0.28209479177387814
    radius = np.log(RADIUS * spacing * np.array([1, 1, THICKNESS]))
    return Parameters(
        np.concatenate(means).astype(np.float32),
        _rotations_to_normals(np.concatenate(normals)).astype(np.float32),
        np.tile(radius, (n, 1)).astype(np.float32),
        logit(np.full(n, OPACITY, np.float32)),
        np.concatenate(colours).astype(np.float32),
        logit(np.concatenate(weights).astype(np.float32)),
        light,
    )


def _rotations_to_normals(normals: Array) -> Array:
    """(n, 4) wxyz of rotations that turn z to the normals (n, 3)."""
    z = normals
    helper = np.where(np.abs(z[:, :1]) < 0.7, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]))
    x = np.cross(helper, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return se3.wxyz(np.stack([x, np.cross(z, x), z], 2))
