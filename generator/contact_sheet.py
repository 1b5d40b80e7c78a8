"""A picture of many objects, each closed, half open and open, seen from the most informative directions.

python -m generator.contact_sheet docs/objects.png        # all objects of the catalog
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from freeart21 import catalog, se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.places import SHEET, check_place
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator import objects, partnet
from generator.motion import hull_points, motion_range
from generator.motion.body import UPRIGHT
from generator.partnet_writer import write_partnet
from generator.rays import Caster
from generator.scene import Scene

_SHARES = (0.0, 0.5, 1.0)
"""Joint states of the three tiles, as shares of the range."""

_FOV = np.radians(20.0)
_FIRST_YAWS, _PITCHES = (-35.0, -60.0), (20.0, 35.0, 52.0)
_YAWS = tuple(range(-155, 205, 30))
_FILL = 0.90
"""Share of a tile that its object fills."""

_APART = 60.0
"""Least difference in yaw between the views of the three tiles, degrees."""

_MARGIN, _CAPTION = 10, 28
_PAPER, _FRAME, _INK, _PALE = (255, 255, 255), (222, 222, 226), (45, 45, 50), (140, 140, 148)

View = tuple[float, float]
"""Yaw and pitch, degrees."""


def contact_sheet(
    names: Sequence[str], path: Path, seed: int = 0, tile: int = 212, columns: int = 3, shader: str = "default"
) -> None:
    """Draw the procedural objects `names` of one seed into the PNG `path`: one card each, `columns` cards a row.

    A card has the object's category and name above three tiles of `tile` pixels. The file has a palette of 256 colours,
    which keeps it small. Raises FreeArtError when an object is unknown or this machine cannot render.
    """
    check_place(path, SHEET)
    if not names:
        raise FreeArtError("a contact sheet needs at least one object")
    cards = [_card(name, tiles(name, seed, tile, shader)) for name in names]
    high, wide = cards[0].shape[:2]
    rows = -(-len(cards) // columns)
    step_y, step_x = high + _MARGIN, wide + _MARGIN
    sheet = np.full((rows * step_y + _MARGIN, min(columns, len(cards)) * step_x + _MARGIN, 3), 255, np.uint8)
    for k, card in enumerate(cards):
        y, x = _MARGIN + k // columns * step_y, _MARGIN + k % columns * step_x
        sheet[y : y + high, x : x + wide] = card
    data = io.BytesIO()
    ours = PngInfo()
    ours.add_text("Software", SHEET.mark.decode())
    Image.fromarray(sheet).quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(
        data, "PNG", optimize=True, pnginfo=ours
    )
    atomic.write_bytes(path, data.getvalue())


def _card(name: str, pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """The tiles of one object side by side in a frame, its category and name above."""
    strip = np.hstack(pictures)
    card = np.full((strip.shape[0] + _CAPTION + 2, strip.shape[1] + 2, 3), 255, np.uint8)
    card[_CAPTION + 1 : -1, 1:-1] = strip
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.52
    category = f"{catalog.find(name).category} / "
    cv2.putText(card, category, (10, 20), font, size, _PALE, 1, cv2.LINE_AA)
    (wide, _), _ = cv2.getTextSize(category, font, size, 1)
    cv2.putText(card, name, (10 + wide, 20), font, size, _INK, 1, cv2.LINE_AA)
    cv2.rectangle(card, (0, 0), (card.shape[1] - 1, card.shape[0] - 1), _FRAME, 1)
    return card


def tiles(name: str, seed: int, tile: int, shader: str = "default") -> list[NDArray[np.uint8]]:
    """Three square pictures (tile, tile, 3) of a procedural object on white: closed, half open and open."""
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        loaded = partnet.load(write_partnet(objects.build(name, seed), Path(place) / name))
        lower, upper = motion_range(loaded.joint)
        hulls = [hull_points(side.surface.mesh()) for side in loaded.sides]
        size = max(float(np.linalg.norm(np.ptp(hull, axis=0))) for hull in hulls)
        camera = Camera.from_fov(2 * tile, 2 * tile, _FOV)  # twice as fine, then halved: smooth edges
        scene = Scene(loaded.asset.urdf, [side.links for side in loaded.sides], camera, 0.01 * size, 60 * size, shader)
        first, second = (side.surface.mesh() for side in loaded.sides)
        states = [lower + share * (upper - lower) for share in _SHARES]
        pictures = []
        for q, (yaw, pitch) in zip(states, choose_views((first, second), loaded.joint, states), strict=True):
            points = np.concatenate([hulls[0], se3.transform(loaded.joint.transform(q), hulls[1])])
            picture = scene.render(_pose(points, yaw, pitch, camera), {**loaded.asset.held, loaded.joint.name: q})
            rgb = np.where((picture.side > 0)[..., None], picture.rgb, 255).astype(np.uint8)
            pictures.append(np.asarray(cv2.resize(rgb, (tile, tile), interpolation=cv2.INTER_AREA), np.uint8))
    return pictures


def choose_views(meshes: tuple[Mesh, Mesh], joint: Joint, states: Sequence[float]) -> list[View]:
    """The view (yaw, pitch) for each of the joint's `states`; the first state is the closed one.

    The first view is a three-quarter view from the front, from higher up for flat objects. Each other view is the best
    of 36 by a score: new surface that is hidden while the object is closed, visibility of the smaller part, size of the
    object, and the distance from the views before, which is at least 60 degrees.
    """
    look = _Look(meshes, joint, states)
    around = [(float(yaw), pitch) for yaw in _YAWS for pitch in _PITCHES]
    shut = [look.patches(states[0], view) for view in (*around, *((yaw, -_PITCHES[1]) for yaw, _ in around[::3]))]
    known = np.unique(np.concatenate([patches for _, patches in shut]))
    ahead = [(yaw, pitch) for pitch in _PITCHES for yaw in _FIRST_YAWS]
    areas = [len(look.patches(states[0], view)[0]) for view in ahead]
    views = [next(view for view, area in zip(ahead, areas, strict=True) if area >= 0.87 * max(areas))]
    for q in states[1:]:
        shown = [look.patches(q, view) for view in around]
        most = max(len(sides) for sides, _ in shown)
        best, best_score = views[0], -np.inf
        for view, (sides, patches) in zip(around, shown, strict=True):
            apart = min(abs((view[0] - other + 180) % 360 - 180) for other, _ in views)
            if apart < _APART or len(sides) == 0:
                continue
            new = float((~np.isin(patches, known)).mean())
            smaller = min(float((sides == 0).mean()), float((sides == 1).mean()))
            score = new + min(smaller, 0.2) + 0.4 * len(sides) / most + 0.1 * apart / 180
            if score > best_score:
                best, best_score = view, score
        views.append(best)
    return views


class _Look:
    """Coarse views of an object as lists of the surface patches that they show."""

    def __init__(self, meshes: tuple[Mesh, Mesh], joint: Joint, states: Sequence[float]) -> None:
        swept = [se3.transform(joint.transform(q), meshes[1].vertices) for q in states]
        corners = np.concatenate([meshes[0].vertices, *swept])
        self._middle = (corners.min(0) + corners.max(0)) / 2
        self._radius = float(np.linalg.norm(corners - self._middle, axis=1).max())
        self._camera = Camera.from_fov(80, 80, _FOV)
        self._caster, self._joint, self._first = Caster(meshes), joint, len(meshes[0].faces)

    def patches(self, q: float, view: View) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Side and patch number of each pixel on the object.

        A patch is the part of a face within a cell of the size of a 16th of the object's radius.
        """
        R = _rotation(*view)
        T = se3.pose(R, np.array([0, 0, 1.05 * self._radius / np.sin(_FOV / 2)]) - R @ self._middle)
        Ts = T, T @ self._joint.transform(q)
        hits = self._caster.look(self._camera, Ts)
        on = hits.side >= 0
        points = (self._camera.rays().reshape(-1, 3) * np.where(on, hits.distance, 0)[:, None])[on]
        side, face = hits.side[on], hits.face[on]
        at_rest = np.where(side[:, None] == 0, *(se3.transform(se3.inverse(T), points) for T in Ts))
        cell = np.floor((at_rest - self._middle) / (self._radius / 16)).astype(np.int64) + 32
        return side, ((face + side * self._first) << 18) + (cell << np.array([12, 6, 0])).sum(1)


def _rotation(yaw: float, pitch: float) -> Array:
    """R_camera_object (3, 3) for a view from `yaw` and `pitch`, degrees."""
    return se3.exp_so3(np.array([np.radians(pitch), 0, 0])) @ UPRIGHT @ se3.exp_so3(np.array([0, 0, -np.radians(yaw)]))


def _pose(points: Array, yaw: float, pitch: float, camera: Camera) -> Array:
    """T_camera_object (4, 4) for a view from (yaw, pitch) in which `points` (n, 3) fill the picture."""
    R = _rotation(yaw, pitch)
    turned = points @ R.T
    middle = (turned.min(0) + turned.max(0)) / 2
    half = _FILL * camera.height / 2 / camera.K[1, 1]
    distance = float(np.ptp(turned, axis=0).max()) / half
    for _ in range(20):  # nearer, and to the middle of what is seen, until that fills the picture
        seen = (turned - middle + [0, 0, distance])[:, :2] / (turned[:, 2:] - middle[2] + distance)
        low, high = seen.min(0), seen.max(0)
        middle[:2] += (low + high) / 2 * distance
        distance *= float((high - low).max()) / 2 / half
    return se3.pose(R, np.array([0, 0, distance]) - middle)


if __name__ == "__main__":
    contact_sheet(catalog.built_in_names(), Path(sys.argv[1]))
