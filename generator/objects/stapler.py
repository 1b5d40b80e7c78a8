"""A desk stapler of about 14 cm: a base, a steel magazine with its staples, and a lid hinged at the back."""

from __future__ import annotations

import numpy as np
from manifold3d import JoinType

from generator import textures
from generator.model import Hinge, Link, Material, ObjectModel, Piece
from generator.shapes import box, plate, polygon, rod, round_box, rounded_outline, tilted, union

_BODIES = ((0.75, 0.07, 0.08), (0.08, 0.22, 0.60), (0.07, 0.42, 0.26), (0.90, 0.45, 0.06), (0.36, 0.12, 0.48))
_STEEL = 7850.0
_ABS = 1050.0


def stapler(seed: int) -> ObjectModel:
    """The stapler of a seed. Mouth towards -x, hinge at +x; the lid opens upwards by positive states."""
    rng = np.random.default_rng([seed, 101])
    length, width = 0.140 * rng.uniform(0.94, 1.08), 0.036 * rng.uniform(0.94, 1.08)
    body = _BODIES[int(rng.integers(len(_BODIES)))]
    steel = Material("steel", (1, 1, 1), "metal", _STEEL, textures.brushed_metal(rng, (0.72, 0.73, 0.76)), 0.03)
    dark = Material("dark_steel", (0.20, 0.20, 0.22), "metal", _STEEL)
    shell = Material("shell", body, "plastic", _ABS)
    hinge_at = (length * 0.40, 0.0, 0.024)
    base = Link("heavy stapler_base", _base(length, width, hinge_at, body, steel, dark, rng))
    magazine = Link(
        "hinge stapler_magazine",
        _magazine(length, hinge_at, steel, rng),
        Hinge("revolute", "link_2", (0, 1, 0), hinge_at, 0.0, 0.05),
    )
    lid = Link(
        "hinge stapler_lid",
        _lid(length, width, hinge_at, shell, body, dark, rng),
        Hinge("revolute", "link_2", (0, 1, 0), hinge_at, 0.0, 1.2),
    )
    return ObjectModel("stapler", "Stapler", (magazine, lid, base), 1, seed)


def _base(
    length: float,
    width: float,
    hinge_at: tuple[float, float, float],
    body: textures.Colour,
    steel: Material,
    dark: Material,
    rng: np.random.Generator,
) -> tuple[Piece, ...]:
    rubber = Material("rubber", (1, 1, 1), "rubber", 1200.0, textures.speckle(rng, (0.09, 0.09, 0.10), 0.5), 0.02)
    paint = Material(
        "base_plastic", (1, 1, 1), "plastic", _ABS, textures.speckle(rng, textures.shade(body, 0.30, 0.03)), 0.02
    )
    slab = plate(rounded_outline(length, width, 0.010), 0.007, "z", 0.0055, 0.0015)
    sole = plate(rounded_outline(length * 0.94, width * 0.86, 0.008), 0.002, "z", 0.001)
    anvil_at = -length * 0.40
    anvil = box((0.020, width * 0.55, 0.0016), (anvil_at, 0, 0.0095), 0.0004)
    grooves = union(box((0.002, 0.012, 0.002), (anvil_at + dx, 0, 0.0105)) for dx in (-0.003, 0.003))
    x, _, z = hinge_at
    profile = polygon([[x - 0.022, 0.008], [x + 0.012, 0.008], [x + 0.009, z + 0.006], [x - 0.008, z + 0.006]])
    cheeks = union(plate(profile, 0.0016, "y", side * (width * 0.39 + 0.0012)) for side in (-1, 1))
    pin = rod(0.0028, width * 0.86, "y", hinge_at, 0.0006)
    ruler = Material("ruler", (1, 1, 1), "paper", 900.0, _ruler(), None)
    return (
        Piece("base_body", slab - sole, paint),
        Piece("base_pad", sole, rubber),
        Piece("base_anvil", anvil - grooves, steel),
        Piece("base_post", cheeks, dark),
        Piece("base_pin", pin, steel),
        Piece("base_ruler", box((length * 0.52, width * 0.30, 0.0004), (-length * 0.02, 0, 0.0092)), ruler),
    )


def _magazine(
    length: float, hinge_at: tuple[float, float, float], steel: Material, rng: np.random.Generator
) -> tuple[Piece, ...]:
    x, _, z = hinge_at
    front = -length * 0.455
    reach, width, height = x - front, 0.0140, 0.0085
    middle = (front + x) / 2
    channel = box((reach, width, height), (middle, 0, z - 0.002), 0.0004)
    channel -= box((reach - 0.002, width - 0.0020, height), (middle, 0, z - 0.002 + 0.0010))
    channel -= box((0.004, width * 0.8, height), (front, 0, z - 0.002 + 0.001))
    staples = Material(
        "staples",
        (1, 1, 1),
        "metal",
        _STEEL * 0.5,
        textures.stripes(((0.80, 0.80, 0.82), (0.62, 0.62, 0.66), (0.86, 0.80, 0.70)), 30),
        0.020,
    )
    strip = box((reach * 0.55, width - 0.0032, height * 0.72), (front + reach * 0.29, 0, z - 0.0012), 0.0006)
    pusher = box((0.010, width - 0.0028, height * 0.9), (front + reach * 0.60, 0, z - 0.0005), 0.001)
    red = Material("pusher", (0.85, 0.12, 0.10), "plastic", 1050.0)
    spring = rod(0.0022, reach * 0.30, "x", (front + reach * 0.78, 0, z + 0.0002))
    coil = Material(
        "spring", (1, 1, 1), "metal", _STEEL * 0.3, textures.stripes(((0.25, 0.25, 0.27), (0.75, 0.75, 0.78)), 12), 0.02
    )
    lean = 0.085  # the magazine's mouth stands a little above the anvil
    return tuple(
        Piece(name, tilted(solid, "y", lean, hinge_at), material)
        for name, solid, material in (
            ("magazine_channel", channel, steel),
            ("magazine_staples", strip, staples),
            ("magazine_pusher", pusher, red),
            ("magazine_spring", spring, coil),
        )
    )


def _lid(
    length: float,
    width: float,
    hinge_at: tuple[float, float, float],
    shell: Material,
    body: textures.Colour,
    dark: Material,
    rng: np.random.Generator,
) -> tuple[Piece, ...]:
    x, _, z = hinge_at
    front, back = -length * 0.485, x + 0.018
    low = z - 0.0035
    outline = [
        [front, low],
        [back - 0.004, low - 0.002],
        [back, low + 0.006],
        [back - 0.006, z + 0.019],
        [back - 0.020, z + 0.0235],
        [x * 0.3, z + 0.0225],
        [-length * 0.25, z + 0.0185],
        [front + 0.016, z + 0.0145],
        [front + 0.004, z + 0.0105],
        [front, z + 0.006],
    ]
    rounded = polygon(outline).offset(-0.0040, JoinType.Miter).offset(0.0040, JoinType.Round, circular_segments=32)
    outer = plate(rounded, width * 0.78, "y", 0.0, 0.0035)
    hollow = round_box((back - front - 0.006, width * 0.78 - 0.006, 0.026), 0.003, ((front + back) / 2, 0, low + 0.003))
    shelled = outer - hollow - rod(0.0031, width, "y", hinge_at)
    nose = box((0.010, width * 0.46, 0.008), (front + 0.0085, 0, low + 0.0133), 0.0015)
    driver = box((0.0012, 0.011, 0.004), (front + 0.006, 0, low + 0.0080))
    lean = 0.085
    red_ink = textures.shade(body, 0.25)
    text = str(rng.choice(["HEAVY DUTY", "OFFICE 24/6", "DESK PRO 26"]))
    sticker = Material(
        "label", (1, 1, 1), "paper", 900.0, textures.label(["FA-21", text], (0.96, 0.95, 0.90), red_ink, 3.2, rng), None
    )
    ends = np.array(outline[6]), np.array(outline[5])
    slope, middle = np.arctan2(*(ends[1] - ends[0])[::-1]), (ends[0] + ends[1]) / 2
    top = tilted(box((length * 0.30, width * 0.42, 0.0006)), "y", -slope, (0, 0, 0)).translate(
        (middle[0], 0, middle[1] + 0.0001)
    )
    side = Material(
        "side_print",
        (1, 1, 1),
        "paper",
        900.0,
        textures.label(["STAPLER  " + str(int(rng.integers(100, 999)))], body, (0.97, 0.97, 0.97), 5.0, None, False),
    )
    prints = union(
        box((length * 0.36, 0.0006, 0.0100), (length * 0.02, s * (width * 0.39 - 0.0001), z + 0.0085)) for s in (-1, 1)
    )
    inside = Material("lid_spring", (0.75, 0.75, 0.78), "metal", _STEEL)
    leaf = box((length * 0.5, 0.008, 0.001), (length * 0.02, 0, z + 0.0140))
    pieces = [
        ("lid_shell", shelled, shell),
        ("lid_nose", nose, dark),
        ("lid_driver", driver, inside),
        ("lid_label", top, sticker),
        ("lid_print", prints, side),
        ("lid_leaf", leaf, inside),
    ]
    return tuple(Piece(name, tilted(solid, "y", lean * 0.6, hinge_at), material) for name, solid, material in pieces)


def _ruler() -> np.ndarray:
    """A centimetre scale, as printed on the base."""
    import cv2

    picture = np.full((96, 640, 3), 235, np.uint8)
    for k in range(33):
        x, long = 20 + k * 600 // 32, k % 4 == 0
        cv2.line(picture, (x, 0), (x, 52 if long else 28), (25, 25, 25), 3)
        if long:
            cv2.putText(picture, str(k // 4), (x - 9, 86), cv2.FONT_HERSHEY_DUPLEX, 0.9, (25, 25, 25), 2, cv2.LINE_AA)
    return picture
