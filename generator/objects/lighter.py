"""Three lighters: a flip-top petrol one of 6 cm, a jet lighter of 7 cm, and a barbecue lighter whose neck folds."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType

from generator import textures
from generator.model import STEEL, Hinge, Link, Material, ObjectModel, Piece, Pieces, Point, Rng, printed, textured
from generator.shapes import (
    box,
    lathe,
    moulded,
    pair,
    plate,
    polygon,
    rod,
    round_box,
    rounded_outline,
    screw,
    smooth_outline,
    softened,
    text_outline,
    tube,
    union,
)
from generator.textures import Colour

_METALS = ((0.78, 0.69, 0.47), (0.74, 0.75, 0.78), (0.30, 0.31, 0.34), (0.72, 0.46, 0.34))
_BRASS = 8500.0
_ZINC = 2200.0
"""Of a cast case with its hollow tank, taken as solid."""
_TORCHES = ((0.09, 0.09, 0.10), (0.25, 0.26, 0.28), (0.15, 0.17, 0.21), (0.23, 0.20, 0.18), (0.50, 0.51, 0.53))
_HANDLES = (
    ((0.78, 0.12, 0.11), (0.12, 0.12, 0.13)),
    ((0.12, 0.28, 0.58), (0.85, 0.86, 0.87)),
    ((0.92, 0.72, 0.14), (0.15, 0.15, 0.16)),
    ((0.20, 0.42, 0.24), (0.13, 0.13, 0.14)),
    ((0.88, 0.88, 0.86), (0.30, 0.32, 0.36)),
)


def flip_lighter(seed: int) -> ObjectModel:
    """The lighter of a seed. Broad faces towards -y and +y, hinge at +x; the lid opens by positive states."""
    rng = np.random.default_rng([seed, 303])
    width, depth = 0.038 * rng.uniform(0.96, 1.05), 0.0130 * rng.uniform(0.96, 1.08)
    seam, height = 0.0355 * rng.uniform(0.97, 1.04), 0.0570 * rng.uniform(0.97, 1.04)
    colour = _METALS[int(rng.integers(len(_METALS)))]
    case = textured("case_metal", "metal", _BRASS, textures.brushed_metal(rng, colour), 0.012)
    ink = textures.shade(colour, 0.25)
    hinge_at = (width / 2 + 0.0006, 0.0, seam)
    body = Link("heavy lighter_body", _body(width, depth, seam, case, colour, ink, rng))
    hinge = Hinge("revolute", "link_1", (0, 1, 0), hinge_at, 0.0, 2.2)
    lid = Link("hinge lid", _lid(width, depth, seam, height, case, colour, ink, rng), hinge)
    return ObjectModel("flip_lighter", "Lighter", (lid, body), 0, seed)


def _body(width: float, depth: float, seam: float, case: Material, colour: Colour, ink: Colour, rng: Rng) -> Pieces:
    shell = round_box((width, depth, seam + 0.006), 0.0022, (0, 0, (seam + 0.006) / 2)).trim_by_plane((0, 0, -1), -seam)
    shell -= box((width - 0.0016, depth - 0.0016, seam), (0, 0, seam / 2 + 0.002))
    ground, word = textures.brushed_metal(rng, colour), str(rng.choice(["STORM", "ASTRA", "NOMAD"]))
    emblem = textured("emblem", "metal", _BRASS, textures.emblem(rng, ground, ink, word))
    size = min(width * 0.78, seam * 0.86)
    front = box((size, 0.0004, size), (0, -depth / 2, seam * 0.5))
    lines = ["FREEART 21", "WINDPROOF", f"No {int(rng.integers(1000, 9999))}"]
    ground = textures.brushed_metal(rng, colour)
    words = textured("inscription", "metal", _BRASS, textures.label(lines, ground, ink, 1.3, rng, False))
    rear = box((width * 0.74, 0.0004, width * 0.57), (0, depth / 2, seam * 0.5))
    stamp = textured("stamp", "metal", _BRASS, textures.label(["FA-21", "BRADFORD"], colour, ink, 2.6, None, False))
    sole = box((width * 0.74, depth * 0.62, 0.0004), (0, 0, 0))
    barrel = rod(0.0013, depth * 0.80, "y", (width / 2 + 0.0006, 0, seam))
    barrel -= box((0.004, depth * 0.27, 0.004), (width / 2, 0, seam))
    hinge = Material("hinge_metal", (0.62, 0.62, 0.64), "metal", STEEL)
    return (
        Piece("case", shell, case),
        Piece("emblem", front, emblem),
        Piece("inscription", rear, words),
        Piece("stamp", sole, stamp),
        Piece("hinge_barrel", barrel, hinge),
        *_insert(width, depth, seam, rng),
    )


def _insert(width: float, depth: float, seam: float, rng: Rng) -> Pieces:
    steel = textured("insert_steel", "metal", STEEL, textures.brushed_metal(rng, (0.66, 0.67, 0.70)), 0.02)
    plan = rounded_outline(width - 0.0022, depth - 0.0022, 0.0016)
    block = plate(plan, seam + 0.0005, "z", (seam + 0.0045) / 2, 0.0004)
    tall, wide, deep = 0.0145, 0.0150, depth - 0.0042
    centre = (-width / 2 + 0.0040 + wide / 2, 0.0, seam + 0.002 + tall / 2)
    screen = plate(rounded_outline(wide, deep, deep * 0.42), tall, "z", centre[2]).translate((centre[0], 0, 0))
    flue = plate(rounded_outline(wide - 0.0012, deep - 0.0012, deep * 0.40), tall * 1.2, "z", centre[2] + 0.0006)
    screen -= flue.translate((centre[0], 0, 0))
    holes = union(
        rod(0.0011, depth * 2, "y", (centre[0] + dx * 0.0036, 0, centre[2] + dz * 0.0034 + 0.001), segments=16)
        for dx in (-1, 0, 1)
        for dz in (-1, 0, 1)
    )
    wheel_at = (width / 2 - 0.0105, 0.0, seam + 0.0088)
    teeth = textured("wheel", "metal", STEEL, textures.knurl((0.52, 0.50, 0.48), 5), 0.006)
    wheel = rod(0.0036, 0.0048, "y", wheel_at, 0.0004)
    yoke = pair(box((0.0075, 0.0008, 0.0085), (wheel_at[0] + 0.0012, 0, seam + 0.0065), 0.0003), "y", 0.0032)
    cam = box((0.0030, 0.0052, 0.0080), (width / 2 - 0.0040, 0, seam + 0.0060), 0.0008)
    wick = Material("wick", (0.90, 0.87, 0.78), "rubber", 400.0)
    thread = rod(0.0014, tall * 0.85, "z", (centre[0], 0, centre[2] - tall * 0.08), segments=16)
    dark = Material("cam", (0.16, 0.16, 0.18), "metal", STEEL)
    return (
        Piece("insert", block, steel),
        Piece("windscreen", screen - holes, steel),
        Piece("flint_wheel", wheel, teeth),
        Piece("yoke", yoke, steel),
        Piece("cam", cam, dark),
        Piece("wick", thread, wick),
    )


def _lid(
    width: float, depth: float, seam: float, height: float, case: Material, colour: Colour, ink: Colour, rng: Rng
) -> Pieces:
    gap = 0.0003
    full = round_box((width, depth, height - seam + 0.010), 0.0030, (0, 0, (height + seam - 0.010) / 2))
    shell = full.trim_by_plane((0, 0, 1), seam + gap)
    shell -= round_box((width - 0.0016, depth - 0.0016, height - seam), 0.0016, (0, 0, (height + seam) / 2 - 0.0012))
    text, ground = str(rng.choice(["* 1932 *", "- XXI -", "SINCE 21"])), textures.brushed_metal(rng, colour)
    crest = textured("crest", "metal", _BRASS, textures.label([text], ground, ink, 2.6))
    tall = (height - seam) * 0.50
    prints = pair(box((tall * 2.4, 0.0004, tall), (0, 0, seam + (height - seam) * 0.48)), "y", depth / 2)
    barrel = rod(0.0013, depth * 0.25, "y", (width / 2 + 0.0006, 0, seam))
    hinge = Material("lid_hinge_metal", (0.50, 0.50, 0.53), "metal", STEEL)
    leaf = box((0.0005, depth * 0.24, (height - seam) * 0.5), (width / 2 + 0.0003, 0, seam + (height - seam) * 0.25))
    soot = Material("lid_inside", (0.33, 0.32, 0.31), "metal", _BRASS)
    spring = box((width * 0.5, 0.0034, 0.0005), (width * 0.18, 0, height - 0.0013))
    return (
        Piece("lid_shell", shell, case),
        Piece("lid_print", prints, crest),
        Piece("lid_barrel", union((barrel, leaf)), hinge),
        Piece("lid_spring", spring, soot),
    )


def torch_lighter(seed: int) -> ObjectModel:
    """The jet lighter of a seed. Broad faces towards -y and +y; its cover, hinged before the trigger, flips up."""
    rng = np.random.default_rng([seed, 321])
    width, depth = 0.0360 * rng.uniform(0.95, 1.06), 0.0165 * rng.uniform(0.95, 1.06)
    seam = 0.0480 * rng.uniform(0.95, 1.05)
    colour = _TORCHES[int(rng.integers(len(_TORCHES)))]
    paint = textured("paint", "metal", _ZINC, textures.speckle(rng, colour, 0.04), 0.015)
    split, pivot = width * 0.20, (width * 0.165, 0.0, seam + 0.0125)
    outline = _torch_outline(width, seam, int(rng.integers(2, 5)))
    body = Link("heavy lighter_body", _torch_body(width, depth, seam, split, pivot, outline, paint, colour, rng))
    hinge = Hinge("revolute", "link_1", (0, 1, 0), pivot, 0.0, 1.9)
    cover = Link("hinge lid", _torch_cover(width, depth, seam, split, pivot, outline, paint, colour, rng), hinge)
    return ObjectModel("torch_lighter", "Lighter", (cover, body), 0, seed)


def _torch_outline(width: float, seam: float, fingers: int) -> CrossSection:
    """The side view of cover and body in one, with scallops for the fingers."""
    half = width / 2
    corners = [
        [-half, 0],
        [half - 0.001, 0],
        [half + 0.0012, seam * 0.6],
        [half, seam + 0.0075],
        [width * 0.20, seam + 0.0155],
        [-width * 0.32, seam + 0.0155],
        [-half, seam + 0.0105],
    ]
    bites = [
        CrossSection.circle(0.0075, 40).translate((-half - 0.0062, seam * 0.74 - k * 0.0105)) for k in range(fingers)
    ]
    return softened(polygon(corners) - CrossSection.batch_boolean(bites, OpType.Add), 0.0024)


def _torch_body(
    width: float,
    depth: float,
    seam: float,
    split: float,
    pivot: Point,
    outline: CrossSection,
    paint: Material,
    colour: Colour,
    rng: Rng,
) -> Pieces:
    gap = 0.0002
    x, _, z = pivot
    solid = moulded(outline, depth, "y", 0.0, 0.0021, 3)
    solid -= box((0.1, 0.1, 0.1), (split + gap - 0.05, 0, seam - gap + 0.05))
    solid -= rod(0.0042, 2 * depth, "y", pivot)
    well = rounded_outline(split + width / 2 - 0.0042, depth - 0.0042, 0.0020)
    solid -= plate(well, 0.004, "z", seam).translate(((split - width / 2) / 2, 0, 0))
    eye = CrossSection.circle(0.0016, 24).translate((x, z))
    tail = CrossSection.square((0.001, 0.003)).translate((split + 0.003, seam + 0.0095))
    solid += plate(CrossSection.batch_hull([eye, tail]), 0.0052, "y")
    solid -= rod(0.00125, 0.0054, "y", pivot, 0, 24)
    ribs = int(rng.integers(4, 8))
    for k in range(ribs):
        bar = rounded_outline(width * (0.62 - 0.035 * k), 0.0012, 0.00055, 12)
        bar = bar.translate((width * 0.06, 0.0065 + 0.0024 * k))
        solid -= pair(plate(bar, 0.0010, "y"), "y", depth / 2)
    window = rounded_outline(0.0042, 0.0150, 0.0020).translate((width * 0.30, seam * 0.66))
    solid -= pair(plate(window, 0.0016, "y"), "y", depth / 2)
    badge = rounded_outline(width * 0.46, 0.0090, 0.0024).translate((-width * 0.12, seam * 0.74))
    raised = moulded(badge, 0.0010, "y", -depth / 2, 0.0003)
    name = text_outline(str(rng.choice(["JET 21", "TURBO", "TORCH", "BLAZE"])), 0.0050, width * 0.38)
    raised -= plate(name.translate((-width * 0.12, seam * 0.74)), 0.0008, "y", -depth / 2 - 0.0005)
    wedge = [
        [split + 0.0026, seam + 0.004],
        [width * 0.46, seam + 0.004],
        [width * 0.46, seam + 0.0102],
        [width * 0.36, seam + 0.0138],
        [split + 0.0026, seam + 0.0148],
    ]
    trigger = smooth_outline(wedge, 0.0012)
    button = moulded(trigger, depth * 0.62, "y", 0.0, 0.0008)
    for k in range(4):
        button -= rod(0.0005, depth, "y", (split + 0.0050 + 0.0016 * k, 0, seam + 0.0148 - 0.0006 * k), segments=12)
    slot = plate(trigger.offset(0.0002, JoinType.Round), depth * 0.62 + 0.0004, "y")
    ink = (0.62, 0.62, 0.62) if sum(colour) < 1.2 else (0.12, 0.12, 0.12)
    lines = ["WARNING", "FLAMMABLE", f"LOT {int(rng.integers(100, 999))}"]
    notice = printed("notice", textures.label(lines, colour, ink, 1.7, None, False))
    note = box((width * 0.40, 0.0002, width * 0.235), (-width * 0.12, depth / 2, seam * 0.72))
    smoke = Material("window", textures.shade(colour, 0.55, 0.02), "plastic", 1180.0)
    trim = Material("trigger", textures.shade(colour, 0.90, 0.01), "plastic", 1050.0)
    return (
        Piece("body", solid - slot, paint),
        Piece("badge", raised, paint),
        Piece("trigger", button, trim),
        Piece("window", pair(plate(window, 0.0012, "y"), "y", depth / 2 - 0.0010), smoke),
        Piece("notice", note, notice),
        *_torch_base(depth, colour),
        *_burner(width, depth, seam, split, rng),
    )


def _torch_base(depth: float, colour: Colour) -> Pieces:
    """The flame's wheel and the filling valve below."""
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    reach = np.where(np.arange(60) % 4 < 2, 0.0044, 0.0040)
    gear = plate(polygon(np.stack([reach * np.cos(turn), reach * np.sin(turn)], -1)), 0.0016, "z", -0.0002)
    gear -= box((0.0060, 0.0009, 0.002), (0, 0, -0.0013))
    valve = rod(0.0020, 0.0012, "z", (0.0095, 0, 0), 0.0002, 28)
    valve -= rod(0.0007, 0.004, "z", (0.0095, 0, -0.002), segments=12)
    dark = Material("adjuster", textures.shade(colour, 0.8, 0.02), "plastic", 1050.0)
    brass = Material("valve", (0.72, 0.58, 0.30), "metal", _BRASS)
    return (Piece("adjuster", gear.translate((-0.004, 0, 0)), dark), Piece("valve", valve, brass))


def _burner(width: float, depth: float, seam: float, split: float, rng: Rng) -> Pieces:
    """Under the cover: a plate with one to three jets and a wire that lights them."""
    steel = textured("burner_steel", "metal", STEEL, textures.brushed_metal(rng, (0.55, 0.55, 0.57)), 0.01)
    jets = int(rng.integers(1, 4))
    middle, room = (split - width / 2) / 2 - 0.0012, depth - 0.0062
    base = moulded(rounded_outline(width * 0.44, room, 0.0022), 0.0020, "z", seam - 0.0010, 0.0004)
    base = base.translate((middle, 0, 0))
    size = 0.0034 if jets == 1 else 0.0023
    nozzles: list[Manifold] = []
    bores: list[Manifold] = []
    for k in range(jets):
        at = (middle + (k - (jets - 1) / 2) * 0.0052, 0.0)
        profile = np.array([[0, 0], [1, 0], [1, 0.0042], [0.85, 0.0046], [0.85, 0.0062], [0, 0.0062]]) * [size, 1]
        nozzles.append(lathe(profile, "z", (*at, seam), 28))
        bores.append(rod(size * 0.55, 0.0040, "z", (*at, seam + 0.0055), segments=20))
        for turn in np.arange(6) * np.pi / 3:
            hole = (at[0] + size * np.cos(turn), size * np.sin(turn), seam + 0.0022)
            bores.append(Manifold.sphere(0.0004, 8).translate(hole))
    brass = Material("jets", (0.70, 0.58, 0.34), "metal", _BRASS)
    start = np.array([middle + width * 0.19, 0.0, seam])
    wire = tube(start + np.array([[0, 0, 0], [0, 0, 0.0075], [-0.0006, 0, 0.0084], [-0.0030, 0, 0.0086]]), 0.00035, 8)
    glass = rod(0.0009, 0.0044, "z", (start[0], 0, seam + 0.0020), 0.0002, 16)
    ceramic = Material("ceramic", (0.88, 0.87, 0.83), "plastic", 2400.0)
    return (
        Piece("burner_plate", base, steel),
        Piece("jets", union(nozzles) - union(bores), brass),
        Piece("spark_wire", wire, steel),
        Piece("spark_insulator", glass, ceramic),
    )


def _torch_cover(
    width: float,
    depth: float,
    seam: float,
    split: float,
    pivot: Point,
    outline: CrossSection,
    paint: Material,
    colour: Colour,
    rng: Rng,
) -> Pieces:
    """A shell open below and, up to the pivot, at its back: there it would sweep through the jets."""
    x, _, z = pivot
    whole = moulded(outline, depth, "y", 0.0, 0.0021, 3)
    wall = 0.0013
    solid = whole ^ box((0.1, 0.1, 0.1), (split - 0.05, 0, seam + 0.05))
    room = plate(outline.offset(-wall, JoinType.Round), depth - 2 * wall, "y")
    solid -= room ^ box((0.1, 0.1, 0.1), (split - wall - 0.05, 0, seam))
    solid -= box((0.010, depth - 2 * wall, 0.1), (split, 0, z - 0.0026 - 0.05))
    solid -= box((split - x + 0.0030 + 0.004, 0.0060, 0.020), (x - 0.0030 + (split - x + 0.0070) / 2, 0, z))
    lip = rounded_outline(0.0022, depth * 0.5, 0.0008)
    solid += moulded(lip, 0.0016, "z", seam + 0.0030, 0.0004).translate((-width / 2, 0, 0))
    pin = rod(0.0011, depth + 0.0008, "y", pivot, 0.0002, 28)
    dark = Material("pin", textures.shade(colour, 0.8, 0.05), "metal", STEEL)
    mark = plate(text_outline(f"{int(rng.integers(1, 99)):02d}", 0.0042), 0.0006, "y", -depth / 2)
    soot = Material("cover_lining", (0.16, 0.15, 0.15), "metal", STEEL)
    lining = box((width * 0.34, depth - 2 * wall - 0.001, 0.0006), (-width * 0.10, 0, seam + 0.0155 - wall - 0.0002))
    return (
        Piece("cover", solid, paint),
        Piece("cover_mark", mark.translate((-width * 0.20, 0, seam + 0.0070)), dark),
        Piece("cover_lining", lining, soot),
        Piece("pin", pin, dark),
    )


def folding_lighter(seed: int) -> ObjectModel:
    """The barbecue lighter of a seed. Handle along x, neck folded on its back; the neck opens over the top to -x."""
    rng = np.random.default_rng([seed, 322])
    neck, thick = 0.092 * rng.uniform(0.94, 1.06), 0.0205 * rng.uniform(0.95, 1.05)
    colour, accent = _HANDLES[int(rng.integers(len(_HANDLES)))]
    handle = Link("heavy lighter_body", _handle(neck, thick, colour, accent, rng))
    hinge = Hinge("revolute", "link_1", (0, -1, 0), (0, 0, 0), 0.0, float(np.pi))
    barrel = Link("hinge lighter_neck", _neck(neck, accent, rng), hinge)
    return ObjectModel("folding_lighter", "Lighter", (barrel, handle), 0, seed)


def _handle(neck: float, thick: float, colour: Colour, accent: Colour, rng: Rng) -> Pieces:
    plastic = textured("handle", "plastic", 1050.0, textures.speckle(rng, colour, 0.03), 0.02)
    rubber = textured("grip_rubber", "rubber", 1150.0, textures.speckle(rng, (0.13, 0.13, 0.14), 0.25), 0.012)
    end = neck + 0.036
    profile = [
        [-0.0095, -0.003],
        [-0.0060, -0.0120],
        [0.008, -0.0165],
        [0.044, -0.0165],
        [0.056, -0.0235],
        [end - 0.030, -0.0250],
        [end - 0.006, -0.0190],
        [end, -0.0080],
        [end - 0.003, 0.0020],
        [end - 0.014, 0.0052],
        [neck + 0.011, 0.0052],
        [neck + 0.003, 0.0008],
        [0.018, 0.0008],
        [0.0075, 0.0085],
        [-0.0055, 0.0080],
        [-0.0105, 0.003],
    ]
    side = softened(polygon(profile), 0.0050, 32)
    solid = moulded(side, thick, "y", 0.0, 0.0038, 4)
    solid -= plate(side, 0.0005, "y") - plate(side.offset(-0.0005, JoinType.Round), 0.0005, "y")  # the halves' seam
    solid -= box((neck + 0.024, 0.0094, 0.05), (neck / 2 - 0.0080, 0, -0.0050 + 0.025), 0.0)
    solid -= rod(0.0084, 0.0094, "y", (0, 0, 0), segments=48)
    hang = rod(0.0030, 0.1, "y", (end - 0.0085, 0, -0.0080), 0, 32)
    hook = [
        [0.044, -0.010],
        [0.016, -0.010],
        [0.0190, -0.0195],
        [0.0265, -0.0260],
        [0.0255, -0.0340],
        [0.0320, -0.0360],
        [0.0410, -0.0250],
    ]
    trigger = softened(polygon(hook), 0.0014)
    solid -= plate(trigger.offset(0.0004, JoinType.Round), 0.0098, "y")
    lever = moulded(trigger, 0.0088, "y", 0.0, 0.0012, 3)
    for k in range(4):
        lever -= rod(0.0006, 0.02, "y", (0.0228 + 0.0016 * k, 0, -0.0202 - 0.0019 * k), segments=12)
    glass = rounded_outline(0.0230, 0.0070, 0.0034).translate((neck * 0.62, -0.0125))
    solid -= plate(glass, 0.1, "y")
    pads = rounded_outline(neck * 0.36, 0.0034, 0.0014)
    rows = int(rng.integers(3, 5))
    grips = union(
        moulded(pads.translate((neck * 0.99, -0.0060 - 0.0046 * k)), 0.0016, "y", s * thick / 2, 0.0006)
        for k in range(rows)
        for s in (-1, 1)
    )
    slide = moulded(rounded_outline(0.0120, 0.0080, 0.0030), 0.0050, "z", 0.0060, 0.0012)
    slide = slide.translate((end - 0.0185, 0, 0))
    for k in (-1, 0, 1):
        slide -= box((0.0008, 0.02, 0.001), (end - 0.0185 + 0.0024 * k, 0, 0.0085))
    red = Material("safety", (0.85, 0.12, 0.10), "plastic", 1050.0)
    dark = Material("trigger", accent, "plastic", 1050.0)
    smoke = Material("window", (0.42, 0.50, 0.52), "plastic", 1180.0)
    pin = rod(0.0034, thick + 0.0006, "y", (0, 0, 0), 0.0006, 32)
    for s in (1, -1):
        pin -= rod(0.0018, 0.1, "y", (0, s * (0.05 + thick / 2 - 0.001), 0), 0, 6)
    steel = Material("bolt", (0.60, 0.60, 0.63), "metal", STEEL)
    heads = union(
        screw(0.0021, "y", (at, -thick / 2 + 0.0002, up), -1)
        for at, up in ((0.0135, -0.0095), (end - 0.0085, 0.0002), (neck * 0.55, -0.0195))
    )
    name = text_outline(str(rng.choice(["GRILL MATE", "LONG REACH", "CAMPFIRE", "EMBER"])), 0.0052, 0.028)
    words = plate(name.translate((0.0300, -0.0080)), 0.0010, "y", -thick / 2)
    lines = ["KEEP AWAY FROM", "CHILDREN", f"GAS {int(rng.integers(10, 99))} ml"]
    sticker = textures.label(lines, (0.96, 0.94, 0.86), (0.12, 0.12, 0.14), 2.7, rng)
    paper = printed("sticker", sticker)
    tail = box((0.0260, 0.0003, 0.0096), (0.0290, thick / 2, -0.0076))
    return (
        Piece("handle", solid - hang, plastic),
        Piece("trigger", lever, dark),
        Piece("window", plate(glass, thick - 0.0016, "y"), smoke),
        Piece("grips", grips, rubber),
        Piece("safety", slide, red),
        Piece("pin", pin, steel),
        Piece("screws", heads, steel),
        Piece("brand", words, dark),
        Piece("sticker", tail, paper),
    )


def _neck(neck: float, accent: Colour, rng: Rng) -> Pieces:
    """A knuckle on the pin, the tube, and a slotted nozzle with its jet and spark wire."""
    steel = textured("neck_steel", "metal", STEEL, textures.brushed_metal(rng, (0.70, 0.71, 0.73)), 0.02)
    knuckle = rod(0.0078, 0.0086, "y", (0, 0, 0), 0.0008, 48) - rod(0.0037, 0.1, "y", (0, 0, 0), 0, 32)
    collar = lathe([[0, 0.006], [0.0043, 0.006], [0.0043, 0.0135], [0.0037, 0.0165], [0, 0.0165]], "x", (0, 0, 0), 32)
    collar -= rod(0.0037, 0.1, "y", (0, 0, 0), 0, 32)
    for k in range(3):
        ring = rod(0.0050, 0.0007, "x", (0.0092 + 0.0018 * k, 0, 0), 0, 32)
        collar -= ring - rod(0.0040, 0.01, "x", (0.010 + 0.0018 * k, 0, 0), 0, 32)
    head = neck - 0.0150
    outer = lathe([[0, 0.014], [0.0031, 0.014], [0.0031, head], [0, head]], "x", (0, 0, 0), 32)
    outer -= rod(0.0024, 0.02, "x", (head, 0, 0), 0, 24)
    flare = [
        [0.0029, head - 0.002],
        [0.0036, head - 0.002],
        [0.0042, head],
        [0.0042, neck - 0.001],
        [0.0036, neck],
        [0.0029, neck],
    ]
    tip = lathe(flare, "x", (0, 0, 0), 32)
    slots = int(rng.integers(4, 7))
    for turn in np.arange(slots) * 2 * np.pi / slots:
        cut = moulded(rounded_outline(0.0062, 0.0018, 0.0008, 12), 0.01, "z", 0.006, 0.0001, 1)
        tip -= cut.translate((neck - 0.0070, 0, 0)).rotate((float(np.degrees(turn)), 0, 0))
    needle = [
        [0, head - 0.008],
        [0.0016, head - 0.008],
        [0.0016, neck - 0.0075],
        [0.0007, neck - 0.0055],
        [0, neck - 0.0055],
    ]
    jet = lathe(needle, "x", (0, 0, 0), 20)
    bend = np.array(
        [[head - 0.008, 0, 0.0020], [neck - 0.006, 0, 0.0021], [neck - 0.0042, 0, 0.0019], [neck - 0.0036, 0, 0.0006]]
    )
    black = Material("knuckle", accent, "plastic", 1050.0)
    burnt = textured("nozzle", "metal", STEEL, textures.brushed_metal(rng, (0.52, 0.50, 0.48)), 0.02)
    brass = Material("jet", (0.74, 0.60, 0.32), "metal", _BRASS)
    mark = Material("neck_band", (0.86, 0.16, 0.12), "plastic", 1050.0)
    band = lathe([[0.0030, 0.0180], [0.0034, 0.0180], [0.0034, 0.0205], [0.0030, 0.0205]], "x", (0, 0, 0), 32)
    return (
        Piece("knuckle", knuckle + collar, black),
        Piece("neck", outer, steel),
        Piece("nozzle", tip, burnt),
        Piece("jet", jet, brass),
        Piece("spark_wire", tube(bend, 0.0004, 8), brass),
        Piece("neck_band", band, mark),
    )
