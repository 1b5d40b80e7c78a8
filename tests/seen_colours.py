"""The colours of an object as seen from all around, and how much of them is one colour."""

from __future__ import annotations

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator import textures
from generator.model import Link, ObjectModel
from generator.partnet_writer import box_uv
from generator.rays import Caster
from generator.shapes import triangles
from generator.surface import Paint

DIRECTIONS, GRID = 26, 70


class Skin:
    """The painted triangles of some links."""

    def __init__(self, links: list[Link]) -> None:
        pieces = [piece for link in links for piece in link.pieces]
        self.paints = []
        corners, uv, paint = [], [], []
        for k, piece in enumerate(pieces):
            m = piece.material
            picture = textures.plain(m.colour) if m.texture is None else m.texture
            self.paints.append(Paint(np.full(3, 255, np.uint8), picture))
            for body in piece.solid.decompose():
                vertices, faces = triangles(body)
                corners.append(vertices[faces])
                uv.append(box_uv(vertices, faces, m.tile_m))
                paint.append(np.full(len(faces), k))
        self.corners, self.uv, self.paint = np.concatenate(corners), np.concatenate(uv), np.concatenate(paint)

    def mesh(self) -> Mesh:
        n = self.corners.size // 3
        return Mesh(self.corners.reshape(n, 3), np.arange(n).reshape(-1, 3), np.zeros((n, 3), np.uint8))

    def at(self, faces: NDArray[np.int64], points: Array) -> NDArray[np.uint8]:
        """Colours (n, 3) at points on faces."""
        weights = trimesh.triangles.points_to_barycentric(self.corners[faces], points)
        uv = (weights[..., None] * self.uv[faces]).sum(1)
        colours = np.zeros((len(faces), 3), np.uint8)
        for k in np.unique(self.paint[faces]):
            here = self.paint[faces] == k
            colours[here] = self.paints[k].at(uv[here])
        return colours


def seen_colours(model: ObjectModel) -> NDArray[np.uint8]:
    """(n, 3) what parallel rays from 26 directions meet, all joints at zero: each stands for the same seen area."""
    moving = model.links[model.scored_joint]
    skins = Skin([link for link in model.links if link is not moving]), Skin([moving])
    meshes = skins[0].mesh(), skins[1].mesh()
    caster = Caster(meshes)
    corners = np.concatenate([mesh.vertices for mesh in meshes])
    middle = (corners.min(0) + corners.max(0)) / 2
    radius = np.linalg.norm(corners - middle, axis=1).max()
    k = np.arange(DIRECTIONS) + 0.5  # a spiral over the sphere
    z, turn = 1 - 2 * k / DIRECTIONS, np.pi * (1 + 5**0.5) * k
    offsets = (np.arange(GRID) + 0.5) / GRID * 2 - 1
    u, v = (g.reshape(-1, 1) for g in np.meshgrid(offsets, offsets))
    colours = []
    for way in np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], -1):
        across = np.linalg.svd(way[None])[2][1:]
        origins = middle - 2 * radius * way + radius * (u * across[0] + v * across[1])
        hits = caster.cast(origins, np.broadcast_to(way, origins.shape), (np.eye(4), np.eye(4)))
        for side, skin in enumerate(skins):
            on = hits.side == side
            colours.append(skin.at(hits.face[on], origins[on] + hits.distance[on, None] * way))
    return np.concatenate(colours)


def main_share(colours: NDArray[np.uint8], distance: float = 18.0) -> float:
    """Share of colours (n, 3) within `distance` of their median in CIELAB (CIE 1976)."""
    lab = cv2.cvtColor((colours[None] / 255).astype(np.float32), cv2.COLOR_RGB2Lab)[0]
    return float((np.linalg.norm(lab - np.median(lab, axis=0), axis=1) <= distance).mean())
