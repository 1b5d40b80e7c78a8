"""Three staplers, each a base, a magazine with its staples and a lid hinged at the back: of 14, 6 and 30 cm."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from manifold3d import CrossSection, JoinType, OpType

from generator import textures
from generator.model import ABS, STEEL, Hinge, Link, Material, ObjectModel, Piece, Pieces, Point, Rng, printed, textured
from generator.shapes import (
    box,
    coil,
    corners,
    moulded,
    pair,
    plate,
    polygon,
    rod,
    round_box,
    rounded_outline,
    screw,
    softened,
    stroke,
    text_outline,
    tilted,
    union,
)
from generator.textures import Colour, Image

_BODIES = ((0.75, 0.07, 0.08), (0.08, 0.22, 0.60), (0.07, 0.42, 0.26), (0.90, 0.45, 0.06), (0.36, 0.12, 0.48))
_PASTELS = ((0.62, 0.82, 0.74), (0.90, 0.66, 0.70), (0.91, 0.91, 0.89), (0.12, 0.12, 0.13), (0.55, 0.70, 0.86))
_GREYS = ((0.56, 0.57, 0.59), (0.27, 0.28, 0.30), (0.74, 0.75, 0.76), (0.42, 0.46, 0.51), (0.60, 0.57, 0.52))


def stapler(seed: int) -> ObjectModel:
    """The stapler of a seed. Mouth towards -x, hinge at +x; the lid opens upwards by positive states."""
    rng = np.random.default_rng([seed, 101])
    length, width = 0.140 * rng.uniform(0.94, 1.08), 0.036 * rng.uniform(0.94, 1.08)
    body = _BODIES[int(rng.integers(len(_BODIES)))]
    steel = textured("steel", "metal", STEEL, textures.brushed_metal(rng, (0.72, 0.73, 0.76)), 0.03)
    dark = Material("dark_steel", (0.20, 0.20, 0.22), "metal", STEEL)
    shell = Material("shell", body, "plastic", ABS)
    hinge_at = (length * 0.40, 0.0, 0.024)
    base = _base(length, width, hinge_at, body, steel, dark, rng)
    magazine = _magazine(length, hinge_at, steel, rng)
    lid = _lid(length, width, hinge_at, shell, body, dark, rng)
    return _assembled("stapler", seed, hinge_at, base, (magazine, 0.05), (lid, 1.2))


def _assembled(
    name: str, seed: int, hinge_at: Point, base: Pieces, magazine: tuple[Pieces, float], lid: tuple[Pieces, float]
) -> ObjectModel:
    """The stapler of its pieces: magazine and lid turn on one pin, each up to its upper limit, rad."""
    links = [
        Link(f"hinge stapler_{part}", pieces, Hinge("revolute", "link_2", (0, 1, 0), hinge_at, 0.0, upper))
        for part, (pieces, upper) in (("magazine", magazine), ("lid", lid))
    ]
    return ObjectModel(name, "Stapler", (*links, Link("heavy stapler_base", base)), 1, seed)


def _base(
    length: float, width: float, hinge_at: Point, body: Colour, steel: Material, dark: Material, rng: Rng
) -> Pieces:
    rubber = textured("rubber", "rubber", 1200.0, textures.speckle(rng, (0.09, 0.09, 0.10), 0.5), 0.02)
    paint = textured("base_plastic", "plastic", ABS, textures.speckle(rng, textures.shade(body, 0.30, 0.03)), 0.02)
    slab = plate(rounded_outline(length, width, 0.010), 0.007, "z", 0.0055, 0.0015)
    sole = plate(rounded_outline(length * 0.94, width * 0.86, 0.008), 0.002, "z", 0.001)
    anvil_at = -length * 0.40
    anvil = box((0.020, width * 0.55, 0.0016), (anvil_at, 0, 0.0095), 0.0004)
    grooves = union(box((0.002, 0.012, 0.002), (anvil_at + dx, 0, 0.0105)) for dx in (-0.003, 0.003))
    x, _, z = hinge_at
    profile = polygon([[x - 0.022, 0.008], [x + 0.012, 0.008], [x + 0.009, z + 0.006], [x - 0.008, z + 0.006]])
    cheeks = pair(plate(profile, 0.0016, "y"), "y", width * 0.39 + 0.0012)
    pin = rod(0.0028, width * 0.86, "y", hinge_at, 0.0006)
    ruler = printed("ruler", _ruler())
    return (
        Piece("base_body", slab - sole, paint),
        Piece("base_pad", sole, rubber),
        Piece("base_anvil", anvil - grooves, steel),
        Piece("base_post", cheeks, dark),
        Piece("base_pin", pin, steel),
        Piece("base_ruler", box((length * 0.52, width * 0.30, 0.0004), (-length * 0.02, 0, 0.0092)), ruler),
    )


def _magazine(length: float, hinge_at: Point, steel: Material, rng: Rng) -> Pieces:
    x, _, z = hinge_at
    front = -length * 0.455
    reach, width, height = x - front, 0.0140, 0.0085
    middle = (front + x) / 2
    channel = box((reach, width, height), (middle, 0, z - 0.002), 0.0004)
    channel -= box((reach - 0.002, width - 0.0020, height), (middle, 0, z - 0.002 + 0.0010))
    channel -= box((0.004, width * 0.8, height), (front, 0, z - 0.002 + 0.001))
    tints = ((0.80, 0.80, 0.82), (0.62, 0.62, 0.66), (0.86, 0.80, 0.70))
    staples = textured("staples", "metal", STEEL * 0.5, textures.stripes(tints, 30), 0.020)
    strip = box((reach * 0.55, width - 0.0032, height * 0.72), (front + reach * 0.29, 0, z - 0.0012), 0.0006)
    pusher = box((0.010, width - 0.0028, height * 0.9), (front + reach * 0.60, 0, z - 0.0005), 0.001)
    red = Material("pusher", (0.85, 0.12, 0.10), "plastic", 1050.0)
    spring = rod(0.0022, reach * 0.30, "x", (front + reach * 0.78, 0, z + 0.0002))
    windings = textures.stripes(((0.25, 0.25, 0.27), (0.75, 0.75, 0.78)), 12)
    coil = textured("spring", "metal", STEEL * 0.3, windings, 0.02)
    lean = 0.085  # the magazine's mouth stands a little above the anvil
    return _leaning(
        lean,
        hinge_at,
        Piece("magazine_channel", channel, steel),
        Piece("magazine_staples", strip, staples),
        Piece("magazine_pusher", pusher, red),
        Piece("magazine_spring", spring, coil),
    )


def _leaning(lean: float, hinge_at: Point, *pieces: Piece) -> Pieces:
    """The pieces turned about the hinge by `lean`, rad."""
    return tuple(replace(piece, solid=tilted(piece.solid, "y", lean, hinge_at)) for piece in pieces)


def _lid(
    length: float, width: float, hinge_at: Point, shell: Material, body: Colour, dark: Material, rng: Rng
) -> Pieces:
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
    sticker = printed("label", textures.label(["FA-21", text], (0.96, 0.95, 0.90), red_ink, 3.2, rng))
    ends = np.array(outline[6]), np.array(outline[5])
    slope, middle = np.arctan2(*(ends[1] - ends[0])[::-1]), (ends[0] + ends[1]) / 2
    top = tilted(box((length * 0.30, width * 0.42, 0.0006)), "y", -slope, (0, 0, 0))
    top = top.translate((middle[0], 0, middle[1] + 0.0001))
    words = [f"STAPLER  {int(rng.integers(100, 999))}"]
    side = printed("side_print", textures.label(words, body, (0.97, 0.97, 0.97), 5.0, None, False))
    prints = pair(box((length * 0.36, 0.0006, 0.0100), (length * 0.02, 0, z + 0.0085)), "y", width * 0.39 - 0.0001)
    inside = Material("lid_spring", (0.75, 0.75, 0.78), "metal", STEEL)
    leaf = box((length * 0.5, 0.008, 0.001), (length * 0.02, 0, z + 0.0140))
    return _leaning(
        lean * 0.6,
        hinge_at,
        Piece("lid_shell", shelled, shell),
        Piece("lid_nose", nose, dark),
        Piece("lid_driver", driver, inside),
        Piece("lid_label", top, sticker),
        Piece("lid_print", prints, side),
        Piece("lid_leaf", leaf, inside),
    )


def _ruler() -> np.ndarray:
    """A centimetre scale, as printed on the base."""
    picture = np.full((96, 640, 3), 235, np.uint8)
    for k in range(33):
        x, long = 20 + k * 600 // 32, k % 4 == 0
        cv2.line(picture, (x, 0), (x, 52 if long else 28), (25, 25, 25), 3)
        if long:
            cv2.putText(picture, str(k // 4), (x - 9, 86), cv2.FONT_HERSHEY_DUPLEX, 0.9, (25, 25, 25), 2, cv2.LINE_AA)
    return picture


def mini_stapler(seed: int) -> ObjectModel:
    """The pocket stapler of a seed, all one colour. Mouth towards -x, hinge at +x; it opens by positive states."""
    rng = np.random.default_rng([seed, 331])
    length, width = 0.062 * rng.uniform(0.95, 1.06), 0.0260 * rng.uniform(0.95, 1.06)
    colour = _PASTELS[int(rng.integers(len(_PASTELS)))]
    shell = textured("shell", "plastic", ABS, textures.speckle(rng, colour, 0.02), 0.02)
    grey = 0.10 + 0.80 * sum(colour) / 3
    r, g, b = (0.55 * grey + 0.45 * c for c in colour)  # coated to go with the shell
    steel = textured("steel", "metal", STEEL, textures.brushed_metal(rng, (r, g, b)), 0.03)
    hinge_at = (length * 0.355, 0.0, 0.0155)
    base = _mini_base(length, width, hinge_at, colour, shell, steel, rng)
    magazine = _mini_magazine(length, hinge_at, colour, steel, rng)
    lid = _mini_lid(length, width, hinge_at, colour, shell, steel, rng)
    return _assembled("mini_stapler", seed, hinge_at, base, (magazine, 0.04), (lid, 1.25))


def _mini_base(
    length: float, width: float, hinge_at: Point, colour: Colour, shell: Material, steel: Material, rng: Rng
) -> Pieces:
    x, _, z = hinge_at
    nose = CrossSection.circle(width * 0.36, 40).translate((-length / 2 + width * 0.36, 0))
    plan = CrossSection.batch_hull([nose, rounded_outline(0.010, width, 0.0042).translate((length / 2 - 0.0050, 0))])
    floor = moulded(plan, 0.0068, "z", 0.0034, 0.0024, 4)
    eye = CrossSection.circle(0.0058, 32).translate((x, z))
    ear = CrossSection.batch_hull([eye, CrossSection.square((0.019, 0.002)).translate((x - 0.0105, 0.004))])
    thick = 0.0022
    floor += pair(moulded(ear, thick, "y", 0, 0.0008, 3), "y", width / 2 - thick / 2 - 0.0004)
    anvil_at = -length * 0.385
    anvil = moulded(rounded_outline(0.0100, width * 0.50, 0.0014), 0.0014, "z", 0.0068, 0.0003)
    anvil = anvil.translate((anvil_at, 0, 0))
    grooves = union(box((0.0012, 0.0100, 0.002), (anvil_at + dx, 0, 0.0081), 0.0002) for dx in (-0.0017, 0.0017))
    dents = int(rng.integers(3, 6))
    for k in range(dents):  # to hold on to, along both sides
        at = -length * 0.10 + 0.0042 * (k - dents / 2)
        floor -= pair(rod(0.0010, 0.02, "z", (at, 0, 0), 0, 12), "y", width * 0.475)
    claw = polygon([[0, -0.0046], [0.0070, -0.0024], [0.0070, 0.0024], [0, 0.0046]])
    claw -= polygon([[0.0030, 0], [0.0071, -0.0007], [0.0071, 0.0007]])
    remover = plate(claw, 0.0010, "z", 0.0052).translate((length / 2 - 0.0020, 0, 0))
    pin = rod(0.0016, width - 0.0010, "y", hinge_at, 0.0003, 32)
    caps = pair(rod(0.0030, 0.0010, "y", (x, 0, z), 0.0003, 32), "y", width / 2 - 0.0004)
    sole = moulded(plan.offset(-0.0030, JoinType.Round), 0.0010, "z", 0.0, 0.0003, 1)
    foot = Material("sole", textures.shade(colour, 0.86), "rubber", 1200.0)
    spring = coil(0.0024, 0.0003, 0.0042, 4, "z", (0.004, 0, 0.0086))
    lines = ["MINI 10", f"FA-{int(rng.integers(100, 999))}"]
    print_ = textures.label(lines, colour, textures.shade(colour, 0.55, 0.10), 2.0, None, False)
    words = printed("base_print", print_)
    return (
        Piece("base_body", floor - grooves, shell),
        Piece("base_sole", sole, foot),
        Piece("base_anvil", anvil - grooves, steel),
        Piece("base_claw", remover, steel),
        Piece("base_pin", pin + caps, steel),
        Piece("base_spring", spring, steel),
        Piece("base_print", box((length * 0.22, length * 0.11, 0.0002), (-length * 0.14, 0, 0.0068)), words),
    )


def _mini_magazine(length: float, hinge_at: Point, colour: Colour, steel: Material, rng: Rng) -> Pieces:
    x, _, z = hinge_at
    front, back, width, height = -length * 0.44, x + 0.0030, 0.0106, 0.0056
    reach, middle, level = back - front, (front + back) / 2, z - 0.0018
    channel = box((reach, width, height), (middle, 0, level), 0.0004)
    channel -= box((reach - 0.0016, width - 0.0014, height), (middle, 0, level + 0.0008))
    channel -= box((0.004, width * 0.7, height), (front, 0, level + 0.0008))
    channel -= rod(0.0019, width * 2, "y", hinge_at, 0, 24)
    slots = union(box((0.0060, 0.1, 0.0012), (front + 0.012 + 0.009 * k, 0, level + 0.0004)) for k in range(2))
    tints = ((0.78, 0.78, 0.80), (0.62, 0.62, 0.66))
    staples = textured("staples", "metal", STEEL * 0.5, textures.stripes(tints, 40), 0.020)
    strip = box((reach * 0.44, width - 0.0024, height * 0.72), (front + reach * 0.25, 0, level + 0.0006), 0.0005)
    pusher = box((0.0050, width - 0.0022, height * 0.85), (front + reach * 0.54, 0, level + 0.0008), 0.0006)
    spring = coil(0.0015, 0.00025, reach * 0.26, 9, "x", (front + reach * 0.72, 0, level + 0.0012))
    dark = Material("pusher", textures.shade(colour, 0.80), "plastic", ABS)
    lean = 0.10 + 0.02 * rng.uniform()  # the magazine's mouth stands a little above the anvil
    return _leaning(
        lean * 0.4,
        hinge_at,
        Piece("magazine_channel", channel - slots, steel),
        Piece("magazine_staples", strip, staples),
        Piece("magazine_pusher", pusher, dark),
        Piece("magazine_spring", spring, steel),
    )


def _mini_lid(
    length: float, width: float, hinge_at: Point, colour: Colour, shell: Material, steel: Material, rng: Rng
) -> Pieces:
    x, _, z = hinge_at
    front, back, top = -length * 0.50, x + 0.0075, z + 0.0140 * rng.uniform(0.95, 1.08)
    wide = width - 0.0062
    profile = [
        [front, z - 0.0010],
        [front + 0.004, z - 0.0030],
        [x, z - 0.0040],
        [back, z - 0.0010],
        [back, top - 0.0050],
        [back - 0.0080, top],
        [front * 0.30, top - 0.0005],
        [front + 0.0060, top - 0.0055],
        [front, top - 0.0090],
    ]
    side = softened(polygon(profile), 0.0042, 40)
    outer = moulded(side, wide, "y", 0.0, 0.0030, 4)
    wall = 0.0014
    inner = moulded(side.offset(-wall, JoinType.Round), wide - 2 * wall, "y", 0.0, 0.0012, 2)
    below = box((0.2, wide - 2 * wall, 0.02), (0, 0, z + 0.0006 - 0.01)) ^ plate(
        side.offset(-wall, JoinType.Round).translate((0, -0.004)), 0.1, "y"
    )
    solid = outer - inner - below
    for s in (-1, 1):  # bosses that take the pin
        boss = rod(0.0036, 0.0026, "y", (x, s * (wide / 2 - 0.0016), z), 0, 28) ^ outer
        solid += boss
    solid -= rod(0.0018, 0.1, "y", hinge_at, 0, 28)
    name = text_outline(str(rng.choice(["MINI", "PICO", "CLIP", "DOT"])), 0.0052, length * 0.34)
    place = (-length * 0.02, z + 0.0052)
    solid -= plate(name.translate(place), 0.0008, "y", -wide / 2)
    solid -= plate(name.mirror((1, 0)).translate(place), 0.0008, "y", wide / 2)
    ribs = int(rng.integers(4, 7))
    for k in range(ribs):  # where the thumb presses
        bar = rounded_outline(0.0010, wide * (0.52 - 0.04 * abs(k - (ribs - 1) / 2)), 0.0004, 12)
        solid += moulded(bar, 0.0012, "z", top - 0.0003, 0.0003, 1).translate((-length * 0.02 + 0.0026 * k, 0, 0))
    driver = box((0.0008, 0.0082, 0.0030), (front + 0.0075, 0, z + 0.0058))
    bend = [[x - 0.0060, top - wall + 0.0003], [x - 0.0120, z + 0.0062], [-length * 0.30, z + 0.0052]]
    leaf = plate(stroke(bend, 0.0003, 8), 0.0060, "y")
    text = [f"No.{int(rng.choice([8, 10, 12]))}", "MADE OF CODE"]
    print_ = textures.label(text, colour, textures.shade(colour, 0.50, 0.10), 1.6, None)
    label_ = printed("label", print_)
    sticker = box((0.0108, 0.0068, 0.0012), (x - 0.0042, 0, top - 0.0003)) ^ outer.translate((0, 0, 0.0001))
    return _leaning(
        -0.02,
        hinge_at,
        Piece("lid_shell", solid, shell),
        Piece("lid_driver", driver, steel),
        Piece("lid_leaf", leaf, steel),
        Piece("lid_label", sticker, label_),
    )


def long_arm_stapler(seed: int) -> ObjectModel:
    """The booklet stapler of a seed, all grey. Mouth towards -x, hinge at +x; the arm opens by positive states."""
    rng = np.random.default_rng([seed, 332])
    length, width = 0.300 * rng.uniform(0.95, 1.05), 0.0240 * rng.uniform(0.95, 1.06)
    colour = _GREYS[int(rng.integers(len(_GREYS)))]
    steel = textured("steel", "metal", STEEL, textures.brushed_metal(rng, textures.shade(colour, 1.08)), 0.04)
    paint = textured("hammer_paint", "metal", STEEL, textures.speckle(rng, colour, 0.07), 0.03)
    hinge_at = (length / 2 - 0.021, 0.0, 0.0345)
    base = _long_base(length, width, hinge_at, colour, paint, steel, rng)
    magazine = _long_magazine(length, hinge_at, colour, steel)
    arm = _long_arm(length, width, hinge_at, colour, paint, steel, rng)
    return _assembled("long_arm_stapler", seed, hinge_at, base, (magazine, 0.02), (arm, 1.0))


def _long_base(
    length: float, width: float, hinge_at: Point, colour: Colour, paint: Material, steel: Material, rng: Rng
) -> Pieces:
    """A channel of sheet steel with anvil, ruler, a stop that slides along it, and the post of the hinge."""
    x, _, z = hinge_at
    deep, sheet = 0.0090, 0.0016
    bars = [
        CrossSection.square((length, width * 1.30), True),
        CrossSection.square((length * 0.20, width * 2.0), True).translate((-length * 0.40, 0)),
        CrossSection.square((length * 0.15, width * 1.8), True).translate((length * 0.425, 0)),
    ]
    plan = softened(CrossSection.batch_boolean(bars, OpType.Add), 0.0060, 32)
    body = moulded(plan, deep, "z", deep / 2 + 0.002, 0.0018, 3)
    body -= plate(plan.offset(-sheet, JoinType.Round), deep, "z", deep / 2 + 0.002 - sheet)
    top = deep + 0.002
    holes = union(rod(0.0034, 0.1, "z", (length * (0.02 + 0.09 * k), 0, 0), 0, 24) for k in range(3))
    feet = corners(rod(0.0050, 0.0060, "z", (0, 0, 0.0030), 0.0008, 28), "xy", length * 0.46, width * 0.72)
    anvil_at = -length * 0.462
    anvil = moulded(rounded_outline(0.0180, width * 0.86, 0.0020), 0.0022, "z", top + 0.0006, 0.0005)
    anvil = anvil.translate((anvil_at, 0, 0))
    grooves = union(box((0.0018, 0.0110, 0.002), (anvil_at + dx, 0, top + 0.0022), 0.0003) for dx in (-0.0030, 0.0030))
    eye = CrossSection.circle(0.0085, 32).translate((x, z))
    cheek = CrossSection.batch_hull([eye, CrossSection.square((0.036, 0.002)).translate((x - 0.021, top - 0.003))])
    cheek -= CrossSection.circle(0.0040, 24).translate((x - 0.003, top + 0.0080))
    post = pair(moulded(cheek, 0.0018, "y", 0, 0.0005), "y", width / 2 + 0.0017)
    post += box((0.0340, width + 0.0030, 0.0016), (x - 0.003, 0, top + 0.0002), 0.0004)
    bolts = union(screw(0.0036, "y", (x, s * (width / 2 + 0.0028), z), s) for s in (-1, 1))
    bolts += union(
        screw(0.0026, "z", (x + dx, sy * width * 0.30, top + 0.0012)) for dx in (-0.013, 0.008) for sy in (-1, 1)
    )
    pin = rod(0.0026, width + 0.0040, "y", hinge_at, 0, 28)
    scale_long, ink = length * 0.46, textures.shade(colour, 0.25)
    rule = textured("ruler", "metal", STEEL, _ruler_cm(scale_long, 0.0105, textures.shade(colour, 1.06), ink))
    strip = box((scale_long, 0.0105, 0.0004), (-length * 0.09, -width * 0.36, top))
    stop_at = -length * rng.uniform(0.02, 0.12)
    fence = moulded(rounded_outline(width * 2.3, 0.0125, 0.0030), 0.0014, "x", stop_at, 0.0004)
    fence = fence.translate((0, 0, top + 0.0064))
    saddle = box((0.0200, width * 1.30 + 0.0060, 0.0016), (stop_at + 0.0100, 0, top + 0.0014), 0.0004)
    flap = box((0.0200, 0.0016, 0.0110), (stop_at + 0.0100, 0, top - 0.0030), 0.0004)
    saddle += pair(flap, "y", width * 0.65 + 0.0022)
    knob = rod(0.0052, 0.0060, "y", (stop_at + 0.0100, -(width * 0.65 + 0.0062), top - 0.0040), 0.0008, 28)
    cuts = [
        rod(0.0006, 0.1, "y", (stop_at + 0.0100 + 0.0053 * np.cos(t), 0, top - 0.0040 + 0.0053 * np.sin(t)), 0, 8)
        for t in np.arange(14) * 2 * np.pi / 14
    ]
    spring = coil(0.0050, 0.0007, 0.0100, 5, "z", (x - 0.052, 0, top + 0.0048))
    knurled = Material("stop_knob", textures.shade(colour, 0.82), "metal", STEEL)
    rubber = Material("feet", textures.shade(colour, 0.70), "rubber", 1200.0)
    lines = ["LONG REACH STAPLER", f"MODEL {int(length * 1000)}  SN {int(rng.integers(10000, 99999))}"]
    name_plate = textures.label(lines, textures.shade(colour, 1.04), ink, 3.6, None)
    plate_ = textured("name_plate", "metal", STEEL, name_plate)
    return (
        Piece("base_channel", body - holes, paint),
        Piece("base_feet", feet, rubber),
        Piece("base_anvil", anvil - grooves, steel),
        Piece("base_post", post, paint),
        Piece("base_bolts", bolts, steel),
        Piece("base_pin", pin, steel),
        Piece("base_ruler", strip, rule),
        Piece("stop", fence + saddle, steel),
        Piece("stop_knob", knob - union(cuts), knurled),
        Piece("base_spring", spring, steel),
        Piece("name_plate", box((length * 0.12, 0.0100, 0.0004), (length * 0.205, width * 0.38, top)), plate_),
    )


def _long_magazine(length: float, hinge_at: Point, colour: Colour, steel: Material) -> Pieces:
    """A channel with staples below the arm's head, on a long strap."""
    x, _, z = hinge_at
    front, reach, width, height, level = -length * 0.480, length * 0.34, 0.0140, 0.0085, 0.0225
    middle = front + reach / 2
    channel = box((reach, width, height), (middle, 0, level), 0.0004)
    channel -= box((reach - 0.002, width - 0.0020, height), (middle, 0, level + 0.0010))
    channel -= box((0.004, width * 0.8, height), (front, 0, level + 0.0010))
    holes = union(rod(0.0016, 0.1, "y", (front + reach * (0.3 + 0.2 * k), 0, level - 0.0004), 0, 20) for k in range(4))
    way = [[front + reach - 0.004, level + 0.001], [x - 0.030, level + 0.006], [x, z]]
    strap = stroke(way, [0.0012, 0.0012, 0.0046])
    rail = plate(strap, 0.0080, "y") - rod(0.0028, 0.1, "y", hinge_at, 0, 28)
    bright = textures.shade(colour, 1.12)
    tints = textures.stripes((bright, textures.shade(bright, 0.86)), 40)
    staples = textured("staples", "metal", STEEL * 0.5, tints, 0.02)
    strip = box((reach * 0.55, width - 0.0032, height * 0.76), (front + reach * 0.29, 0, level + 0.0008), 0.0006)
    pusher = box((0.0100, width - 0.0028, height * 0.9), (front + reach * 0.62, 0, level + 0.0012), 0.001)
    spring = coil(0.0026, 0.0004, reach * 0.28, 12, "x", (front + reach * 0.79, 0, level + 0.0018))
    dark = Material("pusher", textures.shade(colour, 0.78), "plastic", ABS)
    return (
        Piece("magazine_channel", channel - holes, steel),
        Piece("magazine_strap", rail, steel),
        Piece("magazine_staples", strip, staples),
        Piece("magazine_pusher", pusher, dark),
        Piece("magazine_spring", spring, steel),
    )


def _long_arm(
    length: float, width: float, hinge_at: Point, colour: Colour, paint: Material, steel: Material, rng: Rng
) -> Pieces:
    """A channel of sheet steel, open below, with a head over the magazine's mouth and a pad for the palm."""
    x, _, z = hinge_at
    front, back, sheet = -length * 0.492, x + 0.0130, 0.0014
    top = z + 0.0125
    profile = [
        [front, 0.0245],
        [front + length * 0.36, 0.0255],
        [front + length * 0.42, 0.0290],
        [x - 0.030, z - 0.0070],
        [back - 0.004, z - 0.0090],
        [back, z - 0.0050],
        [back, top - 0.0050],
        [back - 0.010, top],
        [front + length * 0.24, top - 0.0020],
        [front + length * 0.18, top + 0.0020],
        [front + 0.014, top + 0.0005],
        [front, top - 0.0100],
    ]
    side = softened(polygon(profile), 0.0040, 32)
    outer = moulded(side, width, "y", 0.0, 0.0022, 3)
    hollow = plate(side.offset(-sheet, JoinType.Round), width - 2 * sheet, "y")
    below = plate(side.offset(-sheet, JoinType.Round).translate((0, -0.006)), width - 2 * sheet, "y")
    solid = outer - hollow - below - rod(0.0029, 0.1, "y", hinge_at, 0, 28)
    holes = int(rng.integers(4, 7))
    for k in range(holes):
        at = front + length * 0.50 + k * length * 0.062
        size = 0.0042 - 0.0003 * k
        solid -= rod(size, 0.1, "y", (at, 0, z + 0.0015), 0, 28)
    bead = rounded_outline(length * 0.46, 0.0050, 0.0024).translate((length * 0.08, 0))
    solid += moulded(bead, 0.0016, "z", top - 0.0002, 0.0006) ^ box((1, 1, 0.0056), (0, 0, top - 0.0014))
    name = text_outline(str(rng.choice(["LONG ARM 30", "BOOKLET 300", "REACH XL"])), 0.0072, length * 0.22)
    place = (front + length * 0.235, z - 0.0002)
    words = union(
        plate(o.translate(place), 0.0012, "y", s * width / 2) for s, o in ((-1, name), (1, name.mirror((1, 0))))
    )
    pad_shape = rounded_outline(length * 0.135, width * 0.80, 0.0070)
    pad = moulded(pad_shape, 0.0050, "z", top + 0.0020, 0.0018, 3).translate((front + length * 0.105, 0, 0))
    for k in range(-2, 3):
        pad -= box((0.0012, width * 0.5, 0.0012), (front + length * 0.105 + 0.0050 * k, 0, top + 0.0045))
    soft = Material("pad", textures.shade(colour, 0.80), "rubber", 1200.0)
    dark = Material("letters", textures.shade(colour, 0.62), "metal", STEEL)
    driver = box((0.0012, 0.0110, 0.0130), (front + 0.0080, 0, z + 0.0010))
    bend = [
        [front + length * 0.36, top - 0.0020],
        [front + length * 0.33, z + 0.0062],
        [front + length * 0.06, z + 0.0056],
    ]
    leaf = plate(stroke(bend, 0.0005, 8), 0.0080, "y")
    lines = ["26/6 - 24/8", f"MAX {int(rng.integers(20, 60))} SHEETS"]
    print_ = textures.label(lines, textures.shade(colour, 1.05), textures.shade(colour, 0.3), 3.0, None)
    label_ = textured("arm_label", "metal", STEEL, print_)
    sticker = box((length * 0.11, length * 0.036, 0.0004), (-length * 0.235 + 0.012, 0, 0))
    slope = np.arctan2(0.0020, x - 0.010 + 0.0130 - front - length * 0.24)
    sticker = tilted(sticker, "y", float(slope), (0, 0, 0)).translate((0, 0, top - 0.0018))
    rivets = union(
        rod(0.0024, 0.0012, "y", (front + length * a, s * width / 2, z - 0.0045), 0.0004, 20)
        for a in (0.07, 0.40)
        for s in (-1, 1)
    )
    return (
        Piece("arm_channel", solid, paint),
        Piece("arm_pad", pad, soft),
        Piece("arm_letters", words, dark),
        Piece("arm_driver", driver, steel),
        Piece("arm_leaf", leaf, steel),
        Piece("arm_label", sticker, label_),
        Piece("arm_rivets", rivets, steel),
    )


def _ruler_cm(length: float, height: float, ground: Colour, ink: Colour) -> Image:
    """A scale of real centimetres and millimetres for a strip of `length` by `height` metres."""
    dense = 8000.0  # pixels a metre
    picture = np.tile(textures.plain(ground)[:1, :1], (round(height * dense), round(length * dense), 1))
    colour = tuple(float(round(255 * c)) for c in ink)
    for mm in range(3, int(length * 1000) - 2):
        x, share = round(mm * 1e-3 * dense), 0.55 if (mm - 3) % 10 == 0 else 0.40 if (mm - 3) % 5 == 0 else 0.25
        cv2.line(picture, (x, 0), (x, round(share * picture.shape[0])), colour, 2)
        if (mm - 3) % 10 == 0:
            at = (x - 8, picture.shape[0] - 8)
            cv2.putText(picture, str((mm - 3) // 10), at, cv2.FONT_HERSHEY_DUPLEX, 0.8, colour, 2, cv2.LINE_AA)
    return picture
