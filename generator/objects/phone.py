"""Sliding phones of the 2000s: a portrait slider, a landscape one with a keyboard, a candy bar with a sliding cover.

All are drawn flat, the screen towards the viewer (x right, y up, z out of the screen), and stood up last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from generator import textures
from generator.model import ABS, STEEL, Finish, Hinge, Link, Material, ObjectModel, Piece, Rng, printed, textured
from generator.shapes import (
    box,
    lathe,
    moulded,
    pair,
    plate,
    repeated,
    rod,
    rounded_outline,
    screw,
    stood,
    text_outline,
    union,
)
from generator.textures import Colour

_FILLED = 1350.0
"""A case with its battery and board, kg/m^3."""
_GLASS = 2500.0
_GLOSS = Material("black_glass", (0.035, 0.037, 0.042), "metal", _GLASS)
_HOLES = Material("dark_holes", (0.03, 0.03, 0.035), "rubber", ABS)
_SLIT = 0.0001
"""Half the slit between two halves."""
_MAT = 0.0055
"""Thickness of a mat of keys with its keys."""

_SLIDERS: tuple[tuple[Colour, Colour, Finish], ...] = (
    ((0.72, 0.73, 0.76), (0.16, 0.17, 0.19), "metal"),
    ((0.93, 0.93, 0.92), (0.62, 0.64, 0.67), "plastic"),
    ((0.60, 0.08, 0.12), (0.11, 0.11, 0.12), "plastic"),
    ((0.93, 0.52, 0.66), (0.95, 0.94, 0.94), "plastic"),
    ((0.14, 0.32, 0.58), (0.76, 0.78, 0.80), "metal"),
)
"""Colours of the upper and the lower half, and the upper one's finish."""

_KEYBOARDS = ((0.10, 0.10, 0.11), (0.15, 0.16, 0.18), (0.09, 0.11, 0.17), (0.16, 0.12, 0.10), (0.09, 0.14, 0.12))
"""Black, graphite, midnight blue, espresso and racing green."""

_COVERED = ((0.66, 0.67, 0.69), (0.14, 0.14, 0.15), (0.66, 0.58, 0.44), (0.36, 0.42, 0.50), (0.50, 0.14, 0.16))
"""Silver, black, champagne, steel blue and burgundy."""

_DIGITS = ("1", "2", "3", "4", "5", "6", "7", "8", "9", "*", "0", "#")
_LETTERS = ("o_o", "abc", "def", "ghi", "jkl", "mno", "pqrs", "tuv", "wxyz", "", "+", "")
_ROWS = ("QWERTYUIOP@", "ASDFGHJKL:<", "^ZXCVBNM,.^")

Cell = tuple[float, float, float, float, str, str]
"""A key: its middle, its width and height, what is printed large and what small."""


def slider_phone(seed: int) -> ObjectModel:
    """A portrait slider of about 10 cm: the half with the screen slides up and bares the digits."""
    rng = np.random.default_rng([seed, 911])
    width, height = 0.0470 * rng.uniform(0.95, 1.05), 0.0980 * rng.uniform(0.95, 1.05)
    upper, lower, finish = _SLIDERS[int(rng.integers(len(_SLIDERS)))]
    brand = str(rng.choice(["FREEART", "NORDIA", "Vexa", "LUMEN"]))
    travel = height * 0.37
    joint = Hinge("prismatic", "link_1", (0, 0, 1), (0, 0, 0), 0.0, travel - 0.001)
    moving = _slider_screen(width, height, travel, upper, lower, finish, brand, rng)
    rest = _slider_base(width, height, travel, lower, upper, brand, rng)
    return _phone("slider_phone", seed, "slider screen_half", moving, rest, joint)


def _slider_screen(
    width: float, height: float, travel: float, colour: Colour, other: Colour, finish: Finish, brand: str, rng: Rng
) -> list[Piece]:
    """The upper half of the slider: screen, loudspeaker, softkeys, a ring of arrows, and its slide plate behind."""
    face = 0.0076
    outline = rounded_outline(width, height, 0.0085, 40)
    case = moulded(outline, face - _SLIT, "z", (face + _SLIT) / 2, 0.0020, 3)
    band = moulded(outline.offset(0.00025) - outline.offset(-0.0010), 0.0016, "z", 0.0034, 0.0002, 1)
    skin = textures.brushed_metal(rng, colour) if finish == "metal" else textures.speckle(rng, colour, 0.03)
    shell = textured("upper_shell", finish, _FILLED, skin, 0.03)
    chrome = Material("chrome", (0.80, 0.81, 0.83), "metal", STEEL)

    keys_high, top = height * 0.28, height / 2
    glass_at, glass = top - 0.0105 - height * 0.255, (width - 0.0070, height * 0.51)
    window = rounded_outline(*glass, 0.0030, 24).translate((0, glass_at))
    cut_window, pane = _recess(window, face, 1, 0.0012, 0.00008)
    display = box((glass[0] * 0.86, glass[1] * 0.82, 0.0002), (0, glass_at - glass[1] * 0.035, face - 0.00002))

    pad_at = -height / 2 + 0.0040 + keys_high / 2
    pad = rounded_outline(width - 0.0060, keys_high, 0.0050, 24).translate((0, pad_at))
    cut_pad, _ = _recess(pad, face, 1, _MAT + 0.0002, 0.0)
    w, h = (width - 0.0076) / 3, (keys_high - 0.0026) / 2
    cells: list[Cell] = [
        (s * w * 1.05, r * h * 0.52, w * 0.86, h * 0.88, text, "")
        for s, r, text in ((-1, 1, "-"), (1, 1, "-"), (-1, -1, "@call"), (1, -1, "@end"))
    ]
    keys = _keypad("function_keys", (width - 0.0062, keys_high - 0.0002), (0, pad_at), face, cells, other)
    ring_out = min(keys_high * 0.42, w * 0.62)
    ring = CrossSection.circle(ring_out, 48) - CrossSection.circle(ring_out * 0.55, 48)
    arrows = moulded(ring, 0.0016, "z", face - 0.0002, 0.0004, 2).translate((0, pad_at, 0))
    press = lathe(
        [(0, 0), (ring_out * 0.50, 0), (ring_out * 0.46, 0.0012), (0, 0.0016)], "z", (0, pad_at, face - 0.0010)
    )

    slots = _slots(0.0015, 0.0100, 0.0017, 3).translate((0, top - 0.0058))
    lens = CrossSection.circle(0.0014, 24).translate((width / 2 - 0.0095, top - 0.0058))
    cut_holes, holes = _recess(slots + lens, face, 1, 0.0010, 0.0005)
    name = _printed(brand, 0.0024, glass[0] * 0.5).translate((0, glass_at + glass[1] * 0.44, face - 0.00010))

    back = rounded_outline(width - 0.0110, height - 0.0160, 0.0040, 24)
    cut_back, slide = _recess(back, _SLIT, -1, 0.0009, 0.00020)
    rails = pair(box((0.0014, height - 0.0240, 0.0010), (0, 0, 0.0006)), "x", width * 0.28)
    steel = textured("slide_steel", "metal", STEEL, textures.brushed_metal(rng, (0.62, 0.63, 0.66)), 0.02)
    note = textures.label([brand, "TYPE FA-21"], (0.90, 0.90, 0.88), (0.1, 0.1, 0.1), 2.4, rng)
    sticker = box((width * 0.42, width * 0.175, 0.0001), (0, travel * 0.5 + height * 0.13, _SLIT + 0.00017))
    return [
        Piece("upper_case", case - union((cut_window, cut_pad, cut_holes, cut_back)), shell),
        Piece("upper_band", band - plate(back, 0.02, "z"), chrome),
        Piece("screen_glass", pane, _GLOSS),
        Piece("screen", display, textured("screen", "metal", _GLASS, _screen_off(rng))),
        keys,
        Piece("arrow_ring", arrows, chrome),
        Piece("select_key", press, Material("select_key", textures.shade(other, 0.8, 0.05), "plastic", ABS)),
        Piece("earpiece", holes, _HOLES),
        Piece("brand", name, chrome),
        Piece("slide_plate", slide - rails, steel),
        Piece("slide_sticker", sticker, printed("slide_sticker", note)),
    ]


def _slider_base(
    width: float, height: float, travel: float, colour: Colour, other: Colour, brand: str, rng: Rng
) -> list[Piece]:
    """The lower half of the slider: the digits in front; camera, battery door and sticker behind; keys and ports."""
    back, face = -0.0086, -_SLIT
    outline = rounded_outline(width, height, 0.0085, 40)
    case = moulded(outline, face - back, "z", (face + back) / 2, 0.0020, 3)
    shell = textured("lower_shell", "plastic", _FILLED, textures.speckle(rng, colour, 0.06), 0.02)
    size = (width - 0.0060, travel - 0.0065)
    at = (0.0, -height / 2 + 0.0038 + size[1] / 2)
    cut_tray = _tray(size, at, face, 0.0030, 24)
    keys = _keypad("digits", size, at, face - 0.00015, _digit_cells(size), textures.shade(other, 0.95, 0.02))
    pieces, cuts = _back(width, height, back, colour, brand, (0.0, height * 0.345), rng)
    sides, gaps = _sides(width, height, (face + back) / 2, other, rng)
    return [Piece("lower_case", case - union((cut_tray, *cuts, *gaps)), shell), keys, *pieces, *sides]


def keyboard_phone(seed: int) -> ObjectModel:
    """A landscape slider of about 12 cm, dark all over: the half with the screen slides up and bares a keyboard."""
    rng = np.random.default_rng([seed, 922])
    width, height = 0.1140 * rng.uniform(0.95, 1.05), 0.0580 * rng.uniform(0.95, 1.05)
    colour = _KEYBOARDS[int(rng.integers(len(_KEYBOARDS)))]
    brand = str(rng.choice(["FREEART", "NORDIA", "TYPO 21", "LUMEN"]))
    travel = height * 0.54
    joint = Hinge("prismatic", "link_1", (0, 0, 1), (0, 0, 0), 0.0, travel - 0.001)
    moving = _keyboard_screen(width, height, colour, brand, rng)
    rest = _keyboard_base(width, height, travel, colour, brand, rng)
    return _phone("keyboard_phone", seed, "slider screen_half", moving, rest, joint)


def _keyboard_screen(width: float, height: float, colour: Colour, brand: str, rng: Rng) -> list[Piece]:
    """The upper half: a wide screen, a trackball among keys on its right, the loudspeaker on its left."""
    face = 0.0072
    case = moulded(rounded_outline(width, height, 0.0100, 40), face - _SLIT, "z", (face + _SLIT) / 2, 0.0018, 3)
    shell = textured("upper_shell", "plastic", _FILLED, textures.speckle(rng, colour, 0.05), 0.02)
    trim = Material("trim", textures.shade(colour, 1.25, 0.03), "metal", STEEL)
    glass, glass_x = (width * 0.665, height - 0.0090), -width * 0.035
    cut_window, pane = _recess(rounded_outline(*glass, 0.0020, 20).translate((glass_x, 0)), face, 1, 0.0012, 0.00008)
    display = box((glass[0] - 0.0060, glass[1] - 0.0060, 0.0002), (glass_x, 0, face - 0.00002))
    outline = rounded_outline(glass[0] + 0.0016, glass[1] + 0.0016, 0.0028, 20)
    bezel = moulded(outline - outline.offset(-0.0009), 0.0010, "z", face, 0.0002, 1).translate((glass_x, 0, 0))

    panel_at = (width / 2 - 0.0105, 0.0)
    size = (0.0125, height - 0.0120)
    cut_panel, _ = _recess(rounded_outline(*size, 0.0020, 20).translate(panel_at), face, 1, _MAT, 0.0)
    texts = ("@home", "@menu", "@back", "@call")
    step = size[1] / 5
    cells: list[Cell] = [
        (0.0, y * step, size[0] - 0.0012, step * 0.86, text, "")
        for y, text in zip((2.0, 1.05, -1.05, -2.0), texts, strict=True)
    ]
    keys = _keypad("side_keys", (size[0] - 0.0002, size[1] - 0.0002), panel_at, face + 0.0002, cells, colour)
    ball_r = min(0.0038, step * 0.40)
    ball = Manifold.sphere(ball_r, 28).translate((*panel_at, face - 0.0008))
    collar = CrossSection.circle(ball_r + 0.0012, 36) - CrossSection.circle(ball_r + 0.0001, 36)
    socket = moulded(collar, 0.0014, "z", face - 0.0001, 0.0003, 2).translate((*panel_at, 0))

    slots = _slots(0.0013, 0.0090, 0.0017, 4).rotate(90).translate((-width / 2 + 0.0075, height * 0.20))
    lens = CrossSection.circle(0.0015, 24).translate((-width / 2 + 0.0075, -height * 0.30))
    cut_holes, holes = _recess(slots + lens, face, 1, 0.0010, 0.0005)
    name = _printed(brand, 0.0030, height * 0.30).rotate((0, 0, 90))
    name = name.translate((-width / 2 + 0.0078, -height * 0.08, face))
    cut_back, slide = _recess(rounded_outline(width - 0.0200, height - 0.0160, 0.0030, 20), _SLIT, -1, 0.0008, 0.0002)
    rails = pair(box((0.0012, height - 0.0220, 0.0008), (0, 0, 0.0005)), "x", width * 0.30)
    steel = textures.brushed_metal(rng, textures.shade(colour, 1.3, 0.05))
    return [
        Piece("upper_case", case - union((cut_window, cut_panel, cut_holes, cut_back)), shell),
        Piece("screen_glass", pane, _GLOSS),
        Piece("screen", display, textured("screen", "metal", _GLASS, _screen_off(rng))),
        Piece("screen_bezel", bezel, trim),
        keys,
        Piece("trackball", ball, Material("trackball", textures.shade(colour, 1.6, 0.10), "plastic", ABS)),
        Piece("trackball_socket", socket, trim),
        Piece("earpiece", holes, _HOLES),
        Piece("brand", name, Material("brand_print", (0.62, 0.63, 0.65), "metal", ABS)),
        Piece("slide_plate", slide - rails, textured("slide_steel", "metal", STEEL, steel, 0.02)),
    ]


def _keyboard_base(width: float, height: float, travel: float, colour: Colour, brand: str, rng: Rng) -> list[Piece]:
    """The lower half: four rows of keys in front; camera, battery door and sticker behind; keys and ports around."""
    back, face = -0.0088, -_SLIT
    case = moulded(rounded_outline(width, height, 0.0100, 40), face - back, "z", (face + back) / 2, 0.0018, 3)
    shell = textured("lower_shell", "plastic", _FILLED, textures.speckle(rng, colour, 0.10), 0.02)
    size = (width - 0.0110, travel - 0.0060)
    at = (0.0, -height / 2 + 0.0034 + size[1] / 2)
    cut_tray = _tray(size, at, face, 0.0020, 20)
    wide, tall = 0.91 * size[0] / 11, size[1] / 4
    cells: list[Cell] = []
    for r, row in enumerate(_ROWS):
        numbers = "1234567890-" if r == 0 else " " * 11
        for c, letter in enumerate(row):
            x, y = (c - 5) * wide, (1.5 - r) * tall
            cells.append((x, y, wide * 0.86, tall * 0.80, {"<": "@back", "^": "@up"}.get(letter, letter), numbers[c]))
    for c, text in ((-5, "@menu"), (-4, "sym"), (-3, "/"), (3, "@left"), (4, "@right"), (5, "@enter")):
        cells.append((c * wide, -1.5 * tall, wide * 0.86, tall * 0.80, text, ""))
    cells.append((0, -1.5 * tall, wide * 4.86, tall * 0.80, "", ""))
    keys = _keypad("keyboard", size, at, face - 0.00015, cells, textures.shade(colour, 1.15, 0.02))
    pieces, cuts = _back(width, height, back, colour, brand, (-width * 0.40, height * 0.24), rng)
    sides, gaps = _sides(width, height, (face + back) / 2, textures.shade(colour, 1.1, 0.02), rng)
    return [Piece("lower_case", case - union((cut_tray, *cuts, *gaps)), shell), keys, *pieces, *sides]


def cover_phone(seed: int) -> ObjectModel:
    """A candy bar of about 13 cm in one colour, bent towards the ear; a cover slides down from its digits."""
    rng = np.random.default_rng([seed, 933])
    width, height = 0.0500 * rng.uniform(0.95, 1.05), 0.1300 * rng.uniform(0.95, 1.04)
    colour = _COVERED[int(rng.integers(len(_COVERED)))]
    brand = str(rng.choice(["FREEART", "NORDIA", "VEXA 21", "LUMEN"]))
    split = -height / 2 + height * 0.43
    bend = rng.uniform(0.7, 1.0)
    envelope = moulded(rounded_outline(width, height, 0.0150, 48), 0.0220, "z", 0.0, 0.0045, 4)
    joint = Hinge("prismatic", "link_1", (0, 0, -1), (0, 0, 0), 0.0, height * 0.43 * 0.80)
    moving = _cover(width, height, split, envelope, colour, brand, rng)
    rest = _bar(width, height, split, envelope, colour, brand, bend, rng)
    return _phone("cover_phone", seed, "slider cover", moving, rest, joint)


def _cover(
    width: float, height: float, split: float, envelope: Manifold, colour: Colour, brand: str, rng: Rng
) -> list[Piece]:
    """The cover: the front of the lower part of the phone, with lips that reach around its sides."""
    face, inner = 0.0110, 0.0078
    paint = textured("cover_paint", "plastic", ABS, textures.speckle(rng, colour, 0.05), 0.02)
    relief = Material("cover_relief", textures.shade(colour, 0.72), "plastic", ABS)
    long = split - 0.0003 + height / 2
    room = box((width - 0.0028, 1, 0.1), (0, 0, inner - 0.05))
    room += box((1, 1, 0.1), (0, -height / 2 + 0.0150 - 0.5, inner - 0.05))  # no lips around the corners
    shell = envelope ^ box((1, long + 0.1, 0.1), (0, split - 0.0003 - (long + 0.1) / 2, 0.05 + 0.0022))
    shell -= room
    hold = (
        box((0.5, 0.0009, 0.0008), bevel=0.0003)
        .trim_by_plane((1, 0, 0), -width * 0.26)
        .trim_by_plane((-1, 0, 0), -width * 0.26)
    )
    ridges = repeated(hold, (0, 0.0022, 0), 5).translate((0, split - 0.0095, face))
    slots = _slots(0.0012, 0.0050, 0.0022, 3).translate((0, -height / 2 + 0.0085))
    cut, holes = _recess(slots, face, 1, 0.0012, 0.0006)
    name = _printed(brand, 0.0042, width * 0.6).translate((0, split - 0.0240, face))
    star = textures.emblem(rng, textures.speckle(rng, colour, 0.05), textures.shade(colour, 0.6), "21")
    seal = box((0.0130, 0.0130, 0.0002), (0, split - 0.0375, face))
    lining = box((width - 0.0100, long - 0.0120, 0.0002), (0, split - 0.0003 - long / 2 + 0.0010, inner + 0.00002))
    return [
        Piece("cover_shell", shell - cut, paint),
        Piece("cover_ridges", ridges, relief),
        Piece("microphone", holes, _HOLES),
        Piece("cover_brand", name, relief),
        Piece("cover_seal", seal, textured("cover_seal", "plastic", ABS, star)),
        Piece("cover_lining", lining, Material("cover_lining", textures.shade(colour, 0.85), "rubber", ABS)),
    ]


def _bar(
    width: float, height: float, split: float, envelope: Manifold, colour: Colour, brand: str, bend: float, rng: Rng
) -> list[Piece]:
    """The candy bar: screen, softkeys and roller above, digits in the bed of the cover below, aerial on top."""
    face, bed, back = 0.0110, 0.0075, -0.0110
    paint = textured("body_paint", "plastic", _FILLED, textures.speckle(rng, colour, 0.05), 0.02)
    relief = Material("relief", textures.shade(colour, 0.72), "plastic", ABS)
    room = box((1, 1, 1), (0, split - 0.5, 0.5 + 0.0019)) - box((width - 0.0032, 1.2, 1), (0, split - 0.5, bed - 0.5))
    case = envelope - room
    size = (width - 0.0075, height * 0.43 - 0.0150)
    at = (0.0, split - 0.0028 - size[1] / 2)
    cut_tray = _tray(size, at, bed, 0.0030, 24)
    keys = _keypad("digits", size, at, bed - 0.00015, _digit_cells(size), colour)

    top = height / 2
    glass = (width * 0.74, height * 0.185)
    glass_at = top - 0.0175 - glass[1] / 2
    cut_window, pane = _recess(rounded_outline(*glass, 0.0040, 24).translate((0, glass_at)), face, 1, 0.0014, 0.00010)
    display = box((glass[0] * 0.84, glass[1] * 0.80, 0.0002), (0, glass_at, face - 0.00004))
    low, high = split + 0.0030, glass_at - glass[1] / 2 - 0.0028
    pad = (width - 0.0085, high - low)
    pad_at = (0.0, (low + high) / 2)
    cut_pad, _ = _recess(rounded_outline(*pad, 0.0050, 24).translate(pad_at), face, 1, _MAT, 0.0)
    w, h = pad[0] / 3, pad[1] / 2
    cells: list[Cell] = [
        (s * w * 0.98, r * h * 0.50, w * 0.84, h * 0.80, text, "")
        for s, r, text in ((-1, 1, "-"), (1, 1, "-"), (-1, -1, "@call"), (1, -1, "@end"))
    ]
    functions = _keypad("function_keys", (pad[0] - 0.0002, pad[1] - 0.0002), pad_at, face + 0.0002, cells, colour)
    teeth = [rod(0.0044, w * 0.62, "x", (0, pad_at[1], face - 0.0016), 0.0006, 28)]
    roller = teeth[0] - union(
        rod(0.0004, w, "x", (0, pad_at[1] + 0.0044 * np.sin(a), face - 0.0016 + 0.0044 * np.cos(a)), segments=8)
        for a in np.arange(-1.4, 1.41, 0.28)
    )
    slots = _slots(0.0014, 0.0085, 0.0022, 3).translate((0, top - 0.0085))
    cut_ear, ear = _recess(slots, face, 1, 0.0010, 0.0005)
    name = _printed(brand, 0.0027, width * 0.4).translate((0, top - 0.0146, face))
    aerial = lathe(
        [(0, 0), (0.0042, 0), (0.0040, 0.0150), (0.0034, 0.0175), (0.0020, 0.0190), (0, 0.0195)], "z", segments=28
    )
    aerial = aerial.rotate((-90, 0, 0)).translate((-width * 0.30, top - 0.0050, -0.0020))
    pieces, cuts = _back(width, height, back, colour, brand, (width * 0.24, height * 0.375), rng)
    sides, gaps = _sides(width, height, -0.0050, textures.shade(colour, 0.92), rng)
    upper = [
        Piece("body", case - union((cut_tray, cut_window, cut_pad, cut_ear, *cuts, *gaps)), paint),
        Piece("screen_glass", pane, _GLOSS),
        Piece("screen", display, textured("screen", "metal", _GLASS, _screen_off(rng))),
        functions,
        Piece("roller", roller, relief),
        Piece("earpiece", ear, _HOLES),
        Piece("brand", name, relief),
        Piece("aerial", aerial, Material("aerial_rubber", textures.shade(colour, 0.90), "rubber", 1200.0)),
        *pieces,
        *sides,
    ]

    def reshape(points: NDArray[np.float64]) -> NDArray[np.float64]:
        above = np.maximum(points[:, 1] - split, 0)
        return np.asarray(np.c_[points[:, :2], points[:, 2] + bend * above**2])

    bent = [replace(piece, solid=piece.solid.refine_to_length(0.007).warp_batch(reshape)) for piece in upper]
    return [bent[0], keys, *bent[1:]]


def _phone(name: str, seed: int, semantic: str, moving: list[Piece], rest: list[Piece], joint: Hinge) -> ObjectModel:
    links = [[replace(piece, solid=stood(piece.solid)) for piece in pieces] for pieces in (moving, rest)]
    return ObjectModel(
        name, "Phone", (Link(semantic, tuple(links[0]), joint), Link("heavy phone_body", tuple(links[1]))), 0, seed
    )


def _back(
    width: float, height: float, back: float, colour: Colour, brand: str, camera_at: tuple[float, float], rng: Rng
) -> tuple[list[Piece], list[Manifold]]:
    """What a phone has behind, and what must be cut out of its case: camera, slots, battery door, name, sticker."""
    x, y = camera_at
    radius = 0.0046
    ring = lathe([(0.0032, 0), (radius, 0), (radius, 0.0006), (0.0040, 0.0010), (0.0034, 0.0010), (0.0032, 0.0004)])
    lens = lathe([(0, 0), (0.0032, 0), (0.0030, 0.0003), (0.0015, 0.0006), (0, 0.0007)])
    flash = plate(rounded_outline(0.0042, 0.0024, 0.0008, 16), 0.0006, "z")
    tall = height > width
    away = (0.0085, 0.0) if tall else (0.0, -0.0085)
    here = (x, y, back)
    door = (width * 0.86, height * 0.52) if tall else (width * 0.62, height * 0.80)
    door_at = (0.0, -height * 0.12) if tall else (width * 0.10, 0.0)
    outline = rounded_outline(*door, 0.0045, 24).translate(door_at)
    seam, line = _recess(outline - outline.offset(-0.00035), back, -1, 0.0004, 0.00015)
    latch_at = (0.0, door_at[1] + door[1] / 2 - 0.0040) if tall else (door_at[0] - door[0] / 2 + 0.0060, 0.0)
    latch = repeated(box((0.0090, 0.0006, 0.0005), bevel=0.0001), (0, 0.0013, 0), 4).translate((*latch_at, back))
    slots = _slots(0.0011, 0.0075, 0.0018, 4)
    slots = slots.translate((0.0, -height * 0.43) if tall else (x, -height * 0.16))
    cut, holes = _recess(slots, back, -1, 0.0010, 0.0005)
    inset = 0.2 * min(width, height)
    screws = union(
        screw(0.0011, "z", (sx * (width / 2 - inset), -height / 2 + inset, back - 0.00005), -1, 16) for sx in (-1, 1)
    )
    text = [brand, f"MODEL FA-{int(rng.integers(100, 999))}", f"IMEI 35{int(rng.integers(10**6, 10**7))}"]
    paper = textures.shade(colour, 1.0, 0.06) if rng.random() < 0.6 else textures.shade(colour, 0.85)
    ink = (0.9, 0.9, 0.9) if sum(colour) < 1.2 else (0.12, 0.12, 0.14)
    note = printed("imei_label", textures.label(text, paper, ink, 2.1, rng, True))
    wide = min(door[0] * 0.66, 0.030)
    sticker = box((wide, wide / 2.1, 0.0002), (door_at[0], door_at[1] - door[1] * 0.26, back))
    emboss = _printed(brand, 0.0055, door[0] * 0.55).rotate((0, 180, 0))
    emboss = emboss.translate((door_at[0], door_at[1] + door[1] * 0.16, back))
    white = Material("flash", (0.86, 0.86, 0.78), "plastic", ABS)
    chrome = Material("lens_ring", textures.shade(colour, 0.75, 0.10), "metal", STEEL)
    dark = Material("seam", textures.shade(colour, 0.35), "rubber", ABS)
    pieces = [
        Piece("camera_ring", ring.rotate((180, 0, 0)).translate(here), chrome),
        Piece("camera_lens", lens.rotate((180, 0, 0)).translate(here), _GLOSS),
        Piece("flash", flash.translate((x + away[0], y + away[1], back)), white),
        Piece("battery_seam", line, dark),
        Piece("battery_latch", latch, dark),
        Piece("loudspeaker", holes, dark),
        Piece("back_screws", screws, Material("screw_steel", (0.45, 0.45, 0.47), "metal", STEEL)),
        Piece("imei_label", sticker, note),
        Piece("back_brand", emboss, chrome),
    ]
    return pieces, [seam, cut]


def _sides(width: float, height: float, level: float, colour: Colour, rng: Rng) -> tuple[list[Piece], list[Manifold]]:
    """Keys on the sides of a case at height `level`, and its ports, with what must be cut out for them."""
    button = Material("side_buttons", textures.shade(colour, 0.9, 0.02), "plastic", ABS)
    rocker = box((0.0014, 0.0170, 0.0030), (-width / 2 - 0.0002, height * 0.16, level), 0.0005)
    rocker -= box((0.0020, 0.0006, 0.0040), (-width / 2 - 0.0010, height * 0.16, level))
    shutter = box((0.0014, 0.0090, 0.0028), (width / 2 + 0.0002, -height * 0.18, level), 0.0005)
    power = box((0.0100, 0.0014, 0.0026), (width * 0.16, height / 2 + 0.0001, level), 0.0005)
    opening = box((0.0090, 0.0040, 0.0026), (0, -height / 2, level), 0.0005)
    tongue = box((0.0062, 0.0016, 0.0007), (0, -height / 2 + 0.0012, level))
    floor = box((0.0086, 0.0004, 0.0022), (0, -height / 2 + 0.0019, level))
    jack = rod(0.0016, 0.0050, "y", (-width * 0.22, -height / 2, level), segments=20)
    jack_floor = rod(0.0016, 0.0006, "y", (-width * 0.22, -height / 2 + 0.0022, level), segments=20)
    gold = Material("contacts", (0.72, 0.60, 0.32), "metal", STEEL)
    dark = Material("port", (0.05, 0.05, 0.055), "rubber", ABS)
    pieces = [
        Piece("volume_rocker", rocker, button),
        Piece("side_keys", union((shutter, power)), button),
        Piece("port_tongue", tongue, gold),
        Piece("ports", union((floor, jack_floor)), dark),
    ]
    return pieces, [opening, jack]


def _recess(outline: CrossSection, face: float, up: int, depth: float, sink: float) -> tuple[Manifold, Manifold]:
    """What to cut from a face at z = `face`, which looks along `up` * z, and what fills it to `sink` below."""
    reach = 0.002
    cut = _prism(outline, depth + reach, face + up * (reach - depth) / 2)
    return cut, _prism(outline, depth - sink, face - up * (depth + sink) / 2)


def _tray(size: tuple[float, float], at: tuple[float, float], face: float, radius: float, segments: int) -> Manifold:
    """What to cut from a face at z = `face` for a mat of keys of `size` about `at`."""
    outline = rounded_outline(size[0] + 0.0004, size[1] + 0.0004, radius, segments).translate(at)
    return _recess(outline, face, 1, _MAT + 0.0002, 0.0)[0]


def _prism(outline: CrossSection, thickness: float, at: float) -> Manifold:
    return Manifold.extrude(outline, thickness).translate((0, 0, at - thickness / 2))


def _slots(width: float, length: float, step: float, count: int) -> CrossSection:
    """Slots one above the other."""
    one = rounded_outline(length, width, width * 0.49, 12)
    slots = CrossSection()
    for k in range(count):
        slots += one.translate((0, (k - (count - 1) / 2) * step))
    return slots


def _printed(text: str, high: float, wide: float) -> Manifold:
    """Raised letters about z = 0, no wider than `wide`."""
    return _prism(text_outline(text, high, wide), 0.0003, 0.0)


def _screen_off(rng: Rng) -> NDArray[np.uint8]:
    """A liquid crystal that is off: nearly black, with the sheen of a window."""
    v, u = np.mgrid[0:128, 0:128] / 128
    sheen = np.clip(1 - np.abs(u + 0.6 * v - rng.uniform(0.6, 1.0)) * 3.0, 0, 1)[..., None]
    colour = np.array((0.055, 0.065, 0.075)) + 0.03 * sheen
    return np.asarray(np.rint(255 * colour), np.uint8)


def _digit_cells(size: tuple[float, float]) -> list[Cell]:
    """The twelve keys of a telephone on a plate of `size`."""
    w, h = 0.94 * size[0] / 3, size[1] / 4
    return [
        ((k % 3 - 1) * w, (1.5 - k // 3) * h, w * 0.90, h * 0.82, digit, letters)
        for k, (digit, letters) in enumerate(zip(_DIGITS, _LETTERS, strict=True))
    ]


def _keypad(
    name: str, size: tuple[float, float], at: tuple[float, float], high: float, cells: Sequence[Cell], colour: Colour
) -> Piece:
    """Keys on one mat of `size` about `at`, their tops at z = `high`, with what is printed on them.

    The mat reaches `_MAT` into the case, where there is room for it: the walls of the keys are then but a small part
    of the piece's depth, and take their colour from the picture's margin.
    """
    mat = box((*size, _MAT - 0.0003), (0, 0, high - _MAT / 2 - 0.00015))
    caps = [
        moulded(rounded_outline(w, h, min(w, h) * 0.22, 12), 0.0015, "z", high - 0.00075, 0.00030, 2).translate(
            (x, y, 0)
        )
        for x, y, w, h, _, _ in cells
    ]
    picture = _key_picture(size, cells, colour)
    solid = union((mat, *caps)).translate((*at, 0))
    return Piece(name, solid, textured(name, "plastic", ABS, picture))


def _key_picture(size: tuple[float, float], cells: Sequence[Cell], colour: Colour) -> NDArray[np.uint8]:
    """The picture of a mat of keys, seen from the front."""
    scale = 16000.0  # pixels a metre
    picture = np.empty((round(size[1] * scale), round(size[0] * scale), 3), np.uint8)
    picture[:] = np.rint(255 * np.array(textures.shade(colour, 0.45)))
    face = tuple(float(round(255 * c)) for c in colour)
    ink = (235.0, 235.0, 235.0) if sum(colour) < 1.4 else (25.0, 28.0, 40.0)
    for x, y, w, h, text, small in cells:
        u, v = (x + size[0] / 2) * scale, (size[1] / 2 - y) * scale
        a, b = w * scale / 2 + 2, h * scale / 2 + 2
        cv2.rectangle(picture, (round(u - a), round(v - b)), (round(u + a), round(v + b)), face, -1)
        if text.startswith("@") and len(text) > 1:
            _sign(picture, text[1:], u, v, 0.55 * min(a, b), ink)
            continue
        shift = 0.38 * a if small.strip() and len(small) > 1 else 0.0
        _letters(picture, text, u - shift, v, 1.05 * b, 1.5 * a, ink)
        if small.strip():
            right, up = (0.42 * a, 0) if shift > 0 else (0.55 * a, 0.55 * b)
            _letters(picture, small, u + right, v - up, 0.5 * b, 0.85 * a, ink)
    return picture


def _letters(
    picture: NDArray[np.uint8], text: str, u: float, v: float, high: float, wide: float, ink: tuple[float, ...]
) -> None:
    """`text` about (u, v), pixels, at most `high` and `wide`."""
    if not text.strip():
        return
    (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 1.0, 2)
    size = min(high / h, wide / w)
    at = (round(u - w * size / 2), round(v + h * size / 2))
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_DUPLEX, size, ink, max(2, round(2.2 * size)), cv2.LINE_AA)


def _sign(picture: NDArray[np.uint8], kind: str, u: float, v: float, r: float, ink: tuple[float, ...]) -> None:
    """One of the signs that keys bear, about (u, v), of radius r pixels."""
    thick = max(2, round(r * 0.30))

    def line(points: Sequence[tuple[float, float]], closed: bool = False) -> None:
        pixels = np.rint([[u + r * a, v - r * b] for a, b in points]).astype(np.int32)
        cv2.polylines(picture, [pixels], closed, ink, thick, cv2.LINE_AA)

    if kind in ("call", "end"):
        shade = (40.0, 165.0, 70.0) if kind == "call" else (205.0, 45.0, 45.0)
        turn = 135 if kind == "call" else 180
        at = (round(u), round(v + (0.4 * r if kind == "end" else 0)))
        cv2.ellipse(picture, at, (round(r), round(r * 0.8)), turn, 20, 160, shade, 2 * thick, cv2.LINE_AA)
    elif kind == "home":
        line([(-0.8, -0.8), (-0.8, 0.1), (0, 0.9), (0.8, 0.1), (0.8, -0.8)], True)
    elif kind == "menu":
        for b in (-0.6, 0.0, 0.6):
            line([(-0.8, b), (0.8, b)])
    elif kind == "back":
        line([(0.9, -0.5), (0.9, 0.4), (-0.8, 0.4)])
        line([(-0.3, 0.9), (-0.8, 0.4), (-0.3, -0.1)])
    elif kind == "enter":
        line([(0.8, 0.8), (0.8, -0.3), (-0.8, -0.3)])
        line([(-0.3, 0.2), (-0.8, -0.3), (-0.3, -0.8)])
    else:
        turned = {"up": 0, "left": 1, "right": -1}[kind]
        c, s = np.cos(turned * np.pi / 2), np.sin(turned * np.pi / 2)
        line([(c * a - s * b, s * a + c * b) for a, b in ((-0.7, -0.5), (0.7, -0.5), (0, 0.7))], True)
