"""preview.png of an asset, drawn from its own files on the CPU: closed on the left, open on the right."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.files import atomic, checked
from freeart21.files.urdf import link_poses
from freeart21.mesh import triangle_normals
from freeart21.se3 import Array
from freeart21.view.link_shapes import ShownUrdf, read_shown
from freeart21.z_buffer import draw_triangles

FILE = "preview.png"
SIDE = 512
"""Pixels along each side of the two images."""
_SUPERSAMPLING = 2
"""Samples per pixel and axis."""
_VIEWPOINT = (1.0, -1.4, 0.9)
"""Direction of the camera from the object: before its front, from its right."""
_LIGHT = (0.35, -0.5, 0.8)
_AMBIENT = 0.55
"""Share of ambient light."""
_GROUND = (236, 238, 241)
_FAR = 1e4
"""Distance of the camera, in images' sides: parallel projection but for a ten thousandth."""
_FILL = 0.86
"""Fraction of the image's side that the object takes."""

Piece = tuple[Array, NDArray[np.integer], Array, NDArray[np.uint8]]


def write_preview(folder: Path, asset: Asset) -> None:
    """Write preview.png (`SIDE`, 2 `SIDE`), in parallel projection, of the finished asset in `folder`.

    On the left the joint is at the limit nearest to zero, on the right at the other one.
    """
    atomic.write_bytes(folder / FILE, checked.encode_png(render_preview(asset)))


def render_preview(asset: Asset) -> NDArray[np.uint8]:
    """(`SIDE`, 2 `SIDE`, 3) RGB of the asset at both ends of its joint, at one scale."""
    shown = read_shown(asset.urdf)
    joint = shown.urdf.joints[asset.joint]
    ends = sorted((joint.lower, joint.upper), key=abs)
    poses = [link_poses(shown.urdf.joints, {**asset.held, asset.joint: q}) for q in ends]
    R = _view_rotation(np.array(_VIEWPOINT))
    drawn = [[p for link in shown.visuals for p in project_link(shown, link, Ts[link], R)] for Ts in poses]
    points = np.concatenate([piece[0] for pieces in drawn for piece in pieces])
    low, high = points.min(0), points.max(0)
    scale = _FILL * SIDE * _SUPERSAMPLING / max(float((high - low)[:2].max()), 1e-9)
    shift = 0.5 * SIDE * _SUPERSAMPLING - scale * 0.5 * (low + high)[:2]
    return np.hstack([_rasterise(pieces, scale, shift, R) for pieces in drawn])


def _view_rotation(eye: Array) -> Array:
    """(3, 3) rows: right, down and away, for an eye that looks at the origin with z up."""
    away = -eye / np.linalg.norm(eye)
    right = np.cross(away, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(away, right), away])


def project_link(shown: ShownUrdf, link: str, T: Array, R: Array) -> list[Piece]:
    """Per visual: vertices (V, 3) right, down and away; triangles; texture coordinates or colours; texture.

    T (4, 4) takes the link to the frame that R (3, 3) turns.
    """
    pieces: list[Piece] = []
    for piece in shown.visuals[link]:
        points = se3.transform(T, piece.mesh.vertices) @ R.T
        if piece.picture is not None and piece.uv is not None:
            image = piece.picture
            size = np.array([image.shape[1], image.shape[0]])
            marks = np.stack([piece.uv[:, 0], 1 - piece.uv[:, 1]], -1) * size - 0.5
        else:
            colours = piece.mesh.colours
            image = np.zeros((0, 0, 3), np.uint8)
            marks = np.full((len(points), 3), 190.0) if colours is None else colours.astype(float)
        pieces.append((points, piece.mesh.faces, np.ascontiguousarray(marks, float), image))
    return pieces


def _rasterise(pieces: list[Piece], scale: float, shift: Array, R: Array) -> NDArray[np.uint8]:
    side = SIDE * _SUPERSAMPLING
    colour = np.empty((side, side, 3))
    colour[:] = _GROUND
    nearest = np.full((side, side), np.inf)
    light = R @ (np.array(_LIGHT) / np.linalg.norm(_LIGHT))
    for points, faces, marks, image in pieces:
        face, weights = np.full((side, side), -1), np.zeros((side, side, 3))
        draw_triangles(scale * points[:, :2] + shift, scale * points[:, 2] + _FAR * side, faces, nearest, face, weights)
        drawn = face >= 0
        normals = triangle_normals(points, faces)
        facing = normals @ light / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
        facing = np.where(normals[:, 2] > 0, -facing, facing)  # seen from behind
        shade = (_AMBIENT + (1 - _AMBIENT) * np.maximum(facing, 0.0))[face[drawn]]
        colour[drawn] = shade[:, None] * colours_at(weights[drawn], marks[faces[face[drawn]]], image)
    small = cv2.resize(colour.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def colours_at(weights: Array, marks: Array, image: NDArray[np.uint8]) -> Array:
    """(n, 3) colours, 0 to 255, at barycentric weights (n, 3) of triangles whose corners have `marks` (n, 3, k)."""
    values = np.einsum("nk,nki->ni", weights, marks)
    if not image.size:
        return np.asarray(values)
    column, row = np.clip(np.rint(values).astype(int), 0, np.array(image.shape[1::-1]) - 1).T
    return image[row, column].astype(float)
