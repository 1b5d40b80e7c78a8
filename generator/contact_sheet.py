"""One picture of many objects, each in three poses: shut, half open and open, seen from different sides."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.files import atomic, checked
from freeart21.se3 import Array
from generator import objects, partnet
from generator.motion import hull_points, motion_range
from generator.partnet_writer import write_partnet
from generator.scene import Scene

_VIEWS = ((0.0, -35.0, 20.0), (0.5, 25.0, 30.0), (1.0, 145.0, 25.0))
"""Share of the joint's range, yaw and pitch of the view, degrees, of the three poses."""

_UPRIGHT: Array = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Camera axes for a look along +x at an object with z up."""


def contact_sheet(
    names: Sequence[str], path: Path, seed: int = 0, tile: int = 220, columns: int = 3, shader: str = "default"
) -> None:
    """Draw the procedural objects `names`, of one seed, as the PNG `path`: `columns` objects a row, three tiles each.

    Raises FreeArtError when an object is unknown or this machine cannot render.
    """
    strips = [_strip(name, seed, tile, shader) for name in names]
    rows = [strips[k : k + columns] for k in range(0, len(strips), columns)]
    blank = np.full_like(strips[0], 255)
    sheet = np.vstack([np.hstack([*row, *[blank] * (columns - len(row))]) for row in rows])
    atomic.write_bytes(path, checked.encode_png(sheet))


def _strip(name: str, seed: int, tile: int, shader: str) -> NDArray[np.uint8]:
    """The three tiles of one object and its name."""
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        loaded = partnet.load(write_partnet(objects.build(name, seed), Path(place) / name))
        lower, upper = motion_range(loaded.joint)
        hulls = [hull_points(side.surface.mesh()) for side in loaded.sides]
        size = max(float(np.linalg.norm(np.ptp(hull, axis=0))) for hull in hulls)
        camera = Camera.from_fov(2 * tile, 2 * tile, np.radians(20))  # twice as fine, then halved: smooth edges
        scene = Scene(loaded.asset.urdf, [side.links for side in loaded.sides], camera, 0.01 * size, 60 * size, shader)
        tiles = []
        for share, yaw, pitch in _VIEWS:
            q = lower + share * (upper - lower)
            points = np.concatenate([hulls[0], se3.transform(loaded.joint.transform(q), hulls[1])])
            T = _view(points, np.radians(yaw), np.radians(pitch), camera)
            picture = scene.render(T, {**loaded.asset.held, loaded.joint.name: q})
            rgb = np.where((picture.side > 0)[..., None], picture.rgb, 255).astype(np.uint8)
            tiles.append(cv2.resize(rgb, (tile, tile), interpolation=cv2.INTER_AREA))
    strip = np.hstack(tiles)
    caption = np.full((26, strip.shape[1], 3), 255, np.uint8)
    cv2.putText(caption, name, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (40, 40, 40), 1, cv2.LINE_AA)
    return np.vstack([strip, caption])


def _view(points: Array, yaw: float, pitch: float, camera: Camera) -> Array:
    """T_camera_object (4, 4) that looks from (yaw, pitch) at `points` (n, 3), which then fill the picture."""
    R = se3.exp_so3(np.array([pitch, 0, 0])) @ _UPRIGHT @ se3.exp_so3(np.array([0, 0, -yaw]))
    turned = points @ R.T
    middle = (turned.min(0) + turned.max(0)) / 2
    half = float((turned.max(0) - turned.min(0))[:2].max()) / 2
    distance = 1.12 * half * 2 * camera.K[1, 1] / camera.height + (turned.max(0) - middle)[2]
    return se3.pose(R, np.array([0, 0, distance]) - middle)
