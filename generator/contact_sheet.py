"""A picture of the procedural objects, each closed, half open and open.

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
from freeart21.se3 import Array
from generator import objects, partnet
from generator.motion import hull_points, motion_range
from generator.motion.body import UPRIGHT
from generator.partnet_writer import write_partnet
from generator.scene import Scene

_SHARES = (0.0, 0.5, 1.0)
"""Joint states of the three tiles, as shares of the range."""

_USUAL_VIEWS = ((-35, 20), (175, 20), (25, 20))
VIEWS: dict[str, tuple[tuple[int, int], ...]] = {
    "swivel_usb": ((-35, 35), (145, 52), (85, 52)),
    "flip_cap_usb": ((-60, 35), (25, 20), (85, 52)),
    "folding_usb": ((-60, 35), (115, 52), (25, 52)),
    "flip_lighter": ((-60, 20), (55, 20), (175, 52)),
    "torch_lighter": ((-35, 20), (55, 20), (-125, 20)),
    "folding_lighter": ((-60, 20), (-155, 20), (55, 52)),
    "stapler": ((-60, 20), (85, 35), (25, 35)),
    "mini_stapler": ((-60, 20), (85, 35), (25, 35)),
    "long_arm_stapler": ((-60, 20), (115, 52), (25, 20)),
    "cover_phone": ((-35, 20), (25, 20), (175, 20)),
    "drawer_unit": ((-35, 20), (85, 52), (-95, 52)),
    "nightstand": ((-35, 20), (55, 52), (-95, 52)),
    "filing_cabinet": ((-35, 20), (55, 35), (-95, 52)),
    "tilt_monitor": ((-35, 20), (175, 35), (25, 35)),
    "folding_display": ((-35, 20), (175, 20), (-125, 20)),
}
"""Yaw and pitch, degrees, of the camera for each tile of an object that `_USUAL_VIEWS` do not show well: the open ones
show what was hidden, 60 degrees or more from each other."""

_FOV = np.radians(20.0)
_FILL = 0.90
"""Share of a tile that its object fills."""
_MARGIN, _CAPTION = 10, 28
_PAPER, _FRAME, _INK, _PALE = (255, 255, 255), (222, 222, 226), (45, 45, 50), (140, 140, 148)


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
        states = [lower + share * (upper - lower) for share in _SHARES]
        pictures = []
        for q, (yaw, pitch) in zip(states, VIEWS.get(name, _USUAL_VIEWS), strict=True):
            points = np.concatenate([hulls[0], se3.transform(loaded.joint.transform(q), hulls[1])])
            picture = scene.render(_pose(points, yaw, pitch, camera), {**loaded.asset.held, loaded.joint.name: q})
            rgb = np.where((picture.side > 0)[..., None], picture.rgb, 255).astype(np.uint8)
            pictures.append(np.asarray(cv2.resize(rgb, (tile, tile), interpolation=cv2.INTER_AREA), np.uint8))
    return pictures


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
