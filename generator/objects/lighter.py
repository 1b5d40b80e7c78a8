"""A flip-top petrol lighter of about 6 cm: a case with its insert (windscreen, wheel), and a lid hinged aside."""

from __future__ import annotations

import numpy as np

from generator import textures
from generator.model import Hinge, Link, Material, ObjectModel, Piece
from generator.shapes import box, plate, rod, round_box, rounded_outline, union

_METALS = ((0.78, 0.69, 0.47), (0.74, 0.75, 0.78), (0.30, 0.31, 0.34), (0.72, 0.46, 0.34))
_BRASS = 8500.0
_STEEL = 7850.0


def flip_lighter(seed: int) -> ObjectModel:
    """The lighter of a seed. Broad faces towards -y and +y, hinge at +x; the lid opens by positive states."""
    rng = np.random.default_rng([seed, 303])
    width, depth = 0.038 * rng.uniform(0.96, 1.05), 0.0130 * rng.uniform(0.96, 1.08)
    seam, height = 0.0355 * rng.uniform(0.97, 1.04), 0.0570 * rng.uniform(0.97, 1.04)
    colour = _METALS[int(rng.integers(len(_METALS)))]
    case = Material("case_metal", (1, 1, 1), "metal", _BRASS, textures.brushed_metal(rng, colour), 0.012)
    ink = textures.shade(colour, 0.25)
    hinge_at = (width / 2 + 0.0006, 0.0, seam)
    body = Link("heavy lighter_body", _body(width, depth, seam, case, colour, ink, rng))
    lid = Link(
        "hinge lid",
        _lid(width, depth, seam, height, case, colour, ink, rng),
        Hinge("revolute", "link_1", (0, 1, 0), hinge_at, 0.0, 2.2),
    )
    return ObjectModel("flip_lighter", "Lighter", (lid, body), 0, seed)


def _body(
    width: float,
    depth: float,
    seam: float,
    case: Material,
    colour: textures.Colour,
    ink: textures.Colour,
    rng: np.random.Generator,
) -> tuple[Piece, ...]:
    shell = round_box((width, depth, seam + 0.006), 0.0022, (0, 0, (seam + 0.006) / 2)).trim_by_plane((0, 0, -1), -seam)
    shell -= box((width - 0.0016, depth - 0.0016, seam), (0, 0, seam / 2 + 0.002))
    emblem = Material(
        "emblem",
        (1, 1, 1),
        "metal",
        _BRASS,
        textures.emblem(rng, textures.brushed_metal(rng, colour), ink, str(rng.choice(["STORM", "ASTRA", "NOMAD"]))),
    )
    size = min(width * 0.78, seam * 0.86)
    front = box((size, 0.0004, size), (0, -depth / 2, seam * 0.5))
    words = Material(
        "inscription",
        (1, 1, 1),
        "metal",
        _BRASS,
        textures.label(
            ["FREEART 21", "WINDPROOF", f"No {int(rng.integers(1000, 9999))}"],
            textures.brushed_metal(rng, colour),
            ink,
            1.3,
            rng,
            False,
        ),
    )
    rear = box((width * 0.74, 0.0004, width * 0.57), (0, depth / 2, seam * 0.5))
    stamp = Material(
        "stamp", (1, 1, 1), "metal", _BRASS, textures.label(["FA-21", "BRADFORD"], colour, ink, 2.6, None, False)
    )
    sole = box((width * 0.74, depth * 0.62, 0.0004), (0, 0, 0))
    barrel = rod(0.0013, depth * 0.80, "y", (width / 2 + 0.0006, 0, seam)) - box(
        (0.004, depth * 0.27, 0.004), (width / 2, 0, seam)
    )
    hinge = Material("hinge_metal", (0.62, 0.62, 0.64), "metal", _STEEL)
    return (
        Piece("case", shell, case),
        Piece("emblem", front, emblem),
        Piece("inscription", rear, words),
        Piece("stamp", sole, stamp),
        Piece("hinge_barrel", barrel, hinge),
        *_insert(width, depth, seam, rng),
    )


def _insert(width: float, depth: float, seam: float, rng: np.random.Generator) -> tuple[Piece, ...]:
    steel = Material("insert_steel", (1, 1, 1), "metal", _STEEL, textures.brushed_metal(rng, (0.66, 0.67, 0.70)), 0.02)
    block = plate(
        rounded_outline(width - 0.0022, depth - 0.0022, 0.0016), seam + 0.0005, "z", (seam + 0.0045) / 2, 0.0004
    )
    tall, wide, deep = 0.0145, 0.0150, depth - 0.0042
    centre = (-width / 2 + 0.0040 + wide / 2, 0.0, seam + 0.002 + tall / 2)
    screen = plate(rounded_outline(wide, deep, deep * 0.42), tall, "z", centre[2]).translate((centre[0], 0, 0))
    screen -= plate(
        rounded_outline(wide - 0.0012, deep - 0.0012, deep * 0.40), tall * 1.2, "z", centre[2] + 0.0006
    ).translate((centre[0], 0, 0))
    holes = union(
        rod(0.0011, depth * 2, "y", (centre[0] + dx * 0.0036, 0, centre[2] + dz * 0.0034 + 0.001), segments=16)
        for dx in (-1, 0, 1)
        for dz in (-1, 0, 1)
    )
    wheel_at = (width / 2 - 0.0105, 0.0, seam + 0.0088)
    teeth = Material("wheel", (1, 1, 1), "metal", _STEEL, textures.knurl((0.52, 0.50, 0.48), 5), 0.006)
    wheel = rod(0.0036, 0.0048, "y", wheel_at, 0.0004)
    yoke = union(
        box((0.0075, 0.0008, 0.0085), (wheel_at[0] + 0.0012, s * 0.0032, seam + 0.0065), 0.0003) for s in (-1, 1)
    )
    cam = box((0.0030, 0.0052, 0.0080), (width / 2 - 0.0040, 0, seam + 0.0060), 0.0008)
    wick = Material("wick", (0.90, 0.87, 0.78), "rubber", 400.0)
    thread = rod(0.0014, tall * 0.85, "z", (centre[0], 0, centre[2] - tall * 0.08), segments=16)
    dark = Material("cam", (0.16, 0.16, 0.18), "metal", _STEEL)
    return (
        Piece("insert", block, steel),
        Piece("windscreen", screen - holes, steel),
        Piece("flint_wheel", wheel, teeth),
        Piece("yoke", yoke, steel),
        Piece("cam", cam, dark),
        Piece("wick", thread, wick),
    )


def _lid(
    width: float,
    depth: float,
    seam: float,
    height: float,
    case: Material,
    colour: textures.Colour,
    ink: textures.Colour,
    rng: np.random.Generator,
) -> tuple[Piece, ...]:
    gap = 0.0003
    full = round_box((width, depth, height - seam + 0.010), 0.0030, (0, 0, (height + seam - 0.010) / 2))
    shell = full.trim_by_plane((0, 0, 1), seam + gap)
    shell -= round_box((width - 0.0016, depth - 0.0016, height - seam), 0.0016, (0, 0, (height + seam) / 2 - 0.0012))
    crest = Material(
        "crest",
        (1, 1, 1),
        "metal",
        _BRASS,
        textures.label(
            [str(rng.choice(["* 1932 *", "- XXI -", "SINCE 21"]))],
            textures.brushed_metal(rng, colour),
            ink,
            2.6,
            None,
            True,
        ),
    )
    tall = (height - seam) * 0.50
    prints = union(box((tall * 2.4, 0.0004, tall), (0, s * depth / 2, seam + (height - seam) * 0.48)) for s in (-1, 1))
    barrel = rod(0.0013, depth * 0.25, "y", (width / 2 + 0.0006, 0, seam))
    hinge = Material("lid_hinge_metal", (0.50, 0.50, 0.53), "metal", _STEEL)
    leaf = box((0.0005, depth * 0.24, (height - seam) * 0.5), (width / 2 + 0.0003, 0, seam + (height - seam) * 0.25))
    soot = Material("lid_inside", (0.33, 0.32, 0.31), "metal", _BRASS)
    spring = box((width * 0.5, 0.0034, 0.0005), (width * 0.18, 0, height - 0.0013))
    return (
        Piece("lid_shell", shell, case),
        Piece("lid_print", prints, crest),
        Piece("lid_barrel", union((barrel, leaf)), hinge),
        Piece("lid_spring", spring, soot),
    )
