"""Storage furniture with drawers: a desktop drawer unit of 26 cm a side, a nightstand, a steel filing cabinet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from manifold3d import Manifold

from generator import textures
from generator.model import Hinge, Link, Material, ObjectModel, Piece, Pieces, Point, Rng, printed, textured
from generator.shapes import (
    box,
    corners,
    lathe,
    moulded,
    pair,
    plate,
    repeated,
    rod,
    round_box,
    rounded_outline,
    screw,
    tilted,
    tube,
    union,
)
from generator.textures import Colour

_FRONTS = ((0.93, 0.92, 0.88), (0.20, 0.36, 0.46), (0.55, 0.16, 0.16), (0.24, 0.40, 0.28), (0.83, 0.66, 0.28))
_WOODS = (
    ((0.80, 0.62, 0.42), (0.55, 0.36, 0.20)),
    ((0.62, 0.42, 0.26), (0.36, 0.20, 0.11)),
    ((0.88, 0.76, 0.58), (0.70, 0.52, 0.34)),
)
_LACQUERS = (
    (0.92, 0.91, 0.88),
    (0.74, 0.75, 0.74),
    (0.62, 0.68, 0.60),
    (0.18, 0.21, 0.27),
    (0.55, 0.60, 0.68),
    (0.80, 0.71, 0.66),
)
_ENAMELS = ((0.72, 0.73, 0.73), (0.42, 0.44, 0.46), (0.86, 0.85, 0.82), (0.47, 0.50, 0.43), (0.70, 0.65, 0.56))
_SPINES = ((0.36, 0.20, 0.20), (0.22, 0.28, 0.38), (0.30, 0.36, 0.28), (0.74, 0.66, 0.50), (0.24, 0.22, 0.22))
_PINE = 520.0
_MDF = 740.0
_PANEL = 0.018
_STEEL_SHEET = 0.0012
_BOARD = 0.010
_GAP = 0.0015


def drawer_unit(seed: int) -> ObjectModel:
    """The drawer unit of a seed. The front faces -x; the drawers open by positive states."""
    rng = np.random.default_rng([seed, 202])
    width, depth, height = np.array([0.235, 0.265, 0.245]) * rng.uniform(0.94, 1.06, 3)
    light, dark = _WOODS[int(rng.integers(len(_WOODS)))]
    paint = _FRONTS[int(rng.integers(len(_FRONTS)))]
    carcass = textured("carcass_wood", "wood", _PINE, textures.wood(rng, light, dark), 0.22)
    split = height * rng.uniform(0.50, 0.58)
    root = Link("heavy furniture_body", _carcass(width, depth, height, split, carcass, rng))
    slide, drawers = Hinge("prismatic", "link_2", (-1, 0, 0), (0, 0, 0), 0.0, depth * 0.72), []
    for k, (bottom, top) in enumerate(((split, height - _BOARD), (_BOARD, split))):
        pieces = _drawer(width - 2 * _BOARD, depth, bottom, top, paint, str(k + 1), rng)
        drawers.append(Link("slider drawer", pieces, slide))
    return ObjectModel("drawer_unit", "StorageFurniture", (*drawers, root), 0, seed)


def _carcass(width: float, depth: float, height: float, split: float, wood: Material, rng: Rng) -> Pieces:
    side = pair(box((depth, _BOARD, height), (0, 0, height / 2), 0.0015), "y", (width - _BOARD) / 2)
    inner = width - 2 * _BOARD
    top = box((depth, inner, _BOARD), (0, 0, height - _BOARD / 2), 0.001)
    bottom = box((depth, inner, _BOARD), (0, 0, _BOARD / 2), 0.001)
    shelf = box((depth - 0.012, inner, 0.006), (0.006, 0, split))
    ply = textured("plywood", "wood", 600.0, textures.wood(rng, (0.78, 0.70, 0.55), (0.66, 0.56, 0.42)), 0.15)
    back = box((0.005, inner, height - 2 * _BOARD), (depth / 2 - 0.0025, 0, height / 2))
    rubber = Material("feet", (0.08, 0.08, 0.09), "rubber", 1100.0)
    feet = corners(rod(0.009, 0.006, "z", (0, 0, -0.003), 0.001), "xy", depth / 2 - 0.02, width / 2 - 0.02)
    lines = ["FREEART-21", "DRAWER UNIT", "MADE OF CODE"]
    sticker = printed("back_label", textures.label(lines, (0.97, 0.97, 0.95), (0.1, 0.1, 0.12), 1.6, rng))
    note = box((0.0006, inner * 0.50, inner * 0.31), (depth / 2 + 0.0002, 0, height * 0.55))
    lines = ["TOOLS & PARTS", "A4 / A5"]
    badge = printed("top_badge", textures.label(lines, (0.95, 0.82, 0.25), (0.15, 0.12, 0.05), 2.2))
    plate = box((depth * 0.40, depth * 0.18, 0.0006), (-depth * 0.12, width * 0.12, height + 0.0002))
    white = np.full((320, 320, 3), 244, np.uint8)
    side_card = printed("side_card", textures.emblem(rng, white, (0.16, 0.22, 0.45), "ARCHIVE"))
    cards = pair(box((height * 0.42, 0.0006, height * 0.42), (depth * 0.05, 0, height * 0.52)), "y", width / 2 + 0.0002)
    return (
        Piece("side_panel", side, wood),
        Piece("top_panel", top, wood),
        Piece("bottom_panel", bottom, wood),
        Piece("shelf", shelf, ply),
        Piece("back_panel", back, ply),
        Piece("feet", feet, rubber),
        Piece("back_label", note, sticker),
        Piece("top_badge", plate, badge),
        Piece("side_card", cards, side_card),
    )


def _drawer(inner: float, depth: float, bottom: float, top: float, paint: Colour, number: str, rng: Rng) -> Pieces:
    front_x = -depth / 2
    lacquer = Material("front_lacquer", paint, "plastic", 700.0)
    wood = textured("drawer_wood", "wood", _PINE, textures.wood(rng, (0.86, 0.78, 0.62), (0.74, 0.62, 0.46)), 0.16)
    steel = textured("handle_metal", "metal", 7850.0, textures.brushed_metal(rng, (0.75, 0.74, 0.72)), 0.05)
    wide, tall = inner - 2 * _GAP, top - bottom - 0.003 - 2 * _GAP
    middle = (top + bottom + 0.003) / 2 if number == "1" else (top + bottom - 0.003) / 2
    front = box((0.012, wide, tall), (front_x + 0.006, 0, middle), 0.0018)
    long, low = depth - 0.030, middle - tall / 2 + 0.004
    wall_h = tall * 0.72
    sides = pair(box((long, 0.006, wall_h), (front_x + 0.012 + long / 2, 0, low + wall_h / 2)), "y", wide / 2 - 0.006)
    rear = box((0.006, wide - 0.018, wall_h), (front_x + 0.009 + long, 0, low + wall_h / 2))
    floor = box((long, wide - 0.014, 0.004), (front_x + 0.012 + long / 2, 0, low + 0.004))
    tints = ((0.20, 0.34, 0.24), (0.24, 0.40, 0.29), (0.86, 0.80, 0.55))
    felt = textured("felt", "rubber", 300.0, textures.stripes(tints, 4), 0.09)
    lining = box((long - 0.004, wide - 0.020, 0.001), (front_x + 0.012 + long / 2, 0, low + 0.0065))
    divider = box((0.004, wide - 0.020, wall_h * 0.7), (front_x + long * 0.55, 0, low + 0.006 + wall_h * 0.35))
    bar_z, reach = middle + tall * 0.16, 0.022
    bar = rod(0.0045, wide * 0.42, "y", (front_x - reach, 0, bar_z), 0.001)
    posts = pair(rod(0.0035, reach + 0.004, "x", (front_x - reach / 2 + 0.002, 0, bar_z)), "y", wide * 0.16)
    text = str(rng.choice(["SCREWS M3", "CABLES", "PENCILS", "RECEIPTS", "BATTERIES"]))
    words = textures.label([f"{number}  {text}"], (0.97, 0.96, 0.90), (0.12, 0.12, 0.18), 3.4)
    card = printed(f"card_{number}", words)
    card_h = min(0.026, tall * 0.28)
    card_at = (front_x, 0, middle - tall * 0.24)
    frame = box((0.0024, card_h * 3.4 + 0.006, card_h + 0.006), card_at, 0.0006)
    paper = box((0.0032, card_h * 3.4, card_h), card_at)
    return (
        Piece("drawer_front", front, lacquer),
        Piece("drawer_side", sides, wood),
        Piece("drawer_back", rear, wood),
        Piece("drawer_bottom", floor, wood),
        Piece("drawer_lining", lining, felt),
        Piece("divider", divider, wood),
        Piece("handle", union((bar, posts)), steel),
        Piece("card_frame", frame - paper, steel),
        Piece("card", paper, card),
    )


@dataclass(frozen=True)
class _Bedside:
    """Measures of a nightstand, metres, and its materials."""

    width: float
    depth: float
    leg: float
    """Height of the carcass's underside."""
    shelf: float
    """Height of the board under the drawer."""
    height: float
    lacquer: Material
    wood: Material
    metal: Material
    ink: Colour


def nightstand(seed: int) -> ObjectModel:
    """The nightstand of a seed: a lacquered box on splayed legs, an open niche below its one drawer.

    The front faces -x; the drawer opens by positive states.
    """
    rng = np.random.default_rng([seed, 211])
    width, depth, height = np.array([0.45, 0.40, 0.55]) * rng.uniform(0.94, 1.06, 3)
    paint = _LACQUERS[int(rng.integers(len(_LACQUERS)))]
    leg = height * rng.uniform(0.26, 0.31)
    brass = [(0.80, 0.66, 0.38), (0.70, 0.70, 0.72), (0.72, 0.50, 0.38)][int(rng.integers(3))]
    pale = textures.shade(paint, 0.9, 0.06)
    stand = _Bedside(
        width,
        depth,
        leg,
        leg + (height - leg) * rng.uniform(0.50, 0.56),
        height,
        Material("lacquer", paint, "plastic", _MDF),
        textured("drawer_wood", "wood", _PINE, textures.wood(rng, pale, textures.shade(pale, 0.88)), 0.30),
        textured("brass", "metal", 8500.0, textures.brushed_metal(rng, brass), 0.05),
        (0.15, 0.14, 0.14) if sum(paint) > 1.5 else (0.85, 0.83, 0.78),
    )
    root = Link("heavy furniture_body", (*_bedside_box(stand), *_bedside_legs(stand), *_bedside_niche(stand, rng)))
    hinge = Hinge("prismatic", "link_1", (-1, 0, 0), (0, 0, 0), 0.0, stand.depth * 0.70)
    drawer = Link("slider drawer", (*_bedside_drawer(stand, rng), *_bedside_contents(stand, rng)), hinge)
    return ObjectModel("nightstand", "StorageFurniture", (drawer, root), 0, seed)


def _bedside_box(s: _Bedside) -> Pieces:
    """The carcass: an overhanging top, sides, bottom, the drawer's board, a back with a hole for cables, runners."""
    board, inner = _PANEL, s.width - 2 * _PANEL
    under = s.height - 0.022
    top = moulded(rounded_outline(s.depth + 0.016, s.width + 0.024, 0.014), 0.022, "z", s.height - 0.011, 0.006, 4)
    sides = pair(box((s.depth, board, under - s.leg), (0, 0, (under + s.leg) / 2), 0.002), "y", (s.width - board) / 2)
    across = [
        box((s.depth - 0.001, inner + 0.002, board), (0.0005, 0, z), 0.0015) for z in (s.leg + board / 2, s.shelf)
    ]
    back = box((0.005, inner + 0.002, under - s.leg - board), (s.depth / 2 - 0.012, 0, (under + s.leg) / 2))
    hole = rod(0.022, 0.1, "x", (s.depth / 2, inner * 0.28, s.leg + (s.shelf - s.leg) * 0.62))
    ring = rod(0.026, 0.009, "x", (s.depth / 2 - 0.012, inner * 0.28, s.leg + (s.shelf - s.leg) * 0.62), 0.002) - hole
    grommet = Material("grommet", textures.shade(s.lacquer.colour, 0.75), "plastic", 1000.0)
    steel = Material("steel", (0.62, 0.63, 0.65), "metal", 7850.0)
    rails = pair(box((s.depth * 0.80, 0.005, 0.012), (-s.depth * 0.02, 0, _runner(s)), 0.001), "y", inner / 2 - 0.0025)
    screws = union(
        screw(0.0045, "x", (s.depth / 2 - 0.0095, y * inner * 0.46, z))
        for y in (-1, 0, 1)
        for z in (s.leg + board * 1.8, under - 0.02)
    )
    lines = ["FREEART HOME", "NIGHTSTAND", "MAX 20 KG"]
    note = printed("maker_label", textures.label(lines, (0.95, 0.95, 0.93), (0.15, 0.15, 0.16), 1.7))
    return (
        Piece("top_panel", top, s.lacquer),
        Piece("side_panel", sides, s.lacquer),
        Piece("shelf", union(across), s.lacquer),
        Piece("back_panel", back - hole, s.lacquer),
        Piece("cable_ring", ring, grommet),
        Piece("runner", rails, steel),
        Piece("back_screws", screws, steel),
        Piece("label", box((0.0005, 0.085, 0.05), (s.depth / 2 - 0.0094, -inner * 0.25, under - 0.10)), note),
    )


def _runner(s: _Bedside) -> float:
    """Height of the drawer's runners."""
    return (s.shelf + _PANEL / 2 + s.height - 0.022) / 2


def _bedside_legs(s: _Bedside) -> Pieces:
    """Four turned legs, tapered and splayed, in metal shoes, under an apron."""
    profile = [
        [0.0, 0.0],
        [0.0105, 0],
        [0.0125, 0.004],
        [0.0205, s.leg - 0.012],
        [0.023, s.leg - 0.004],
        [0.023, s.leg],
    ]
    leg = lathe([*profile, [0, s.leg]])
    shoe = lathe([[0.0, 0.0], [0.0125, 0], [0.0135, 0.002], [0.0152, 0.034], [0.0140, 0.036], [0, 0.036]])
    pad = lathe([[0, -0.003], [0.010, -0.003], [0.010, 0.001], [0, 0.001]], segments=24)
    legs: list[Manifold] = []
    shoes: list[Manifold] = []
    pads: list[Manifold] = []
    for x in (-1, 1):
        for y in (-1, 1):
            at = (x * (s.depth / 2 - 0.045), y * (s.width / 2 - 0.045), 0.0)
            for solid, into in ((leg - shoe, legs), (shoe, shoes), (pad, pads)):
                moved = tilted(tilted(solid, "y", -x * 0.10, (0, 0, s.leg)), "x", y * 0.10, (0, 0, s.leg))
                into.append(moved.translate(at))
    apron = box((s.depth - 0.05, s.width - 0.05, 0.022), (0, 0, s.leg - 0.008), 0.002)
    apron -= box((s.depth - 0.086, s.width - 0.086, 0.05), (0, 0, s.leg - 0.025))
    felt = Material("felt", (0.30, 0.28, 0.26), "rubber", 300.0)
    return (
        Piece("leg", union(legs) - apron, s.lacquer),
        Piece("leg_shoe", union(shoes), s.metal),
        Piece("leg_pad", union(pads) - union(shoes), felt),
        Piece("apron", apron, s.lacquer),
    )


def _bedside_niche(s: _Bedside, rng: Rng) -> Pieces:
    """A pile of books in the open niche."""
    pieces: list[Piece] = []
    z = s.leg + _PANEL
    titles = rng.permutation(
        ["THE LONG HINGE", "ON DRAWERS", "NIGHT TRAINS", "A SLIDING SCALE", "QUIET HOURS", "ATLAS"]
    )
    for k in range(int(rng.integers(2, 4))):
        thick = rng.uniform(0.020, 0.034)
        size = (rng.uniform(0.14, 0.17), rng.uniform(0.20, 0.24) - 0.012 * k, thick)
        colour = _SPINES[int(rng.integers(len(_SPINES)))]
        book = _book(size, colour, str(titles[k]), f"book_{k + 1}")
        turn, y = rng.uniform(-7, 7), rng.uniform(-0.012, 0.012) - s.width * 0.06
        at = (-s.depth / 2 + 0.045 + size[0] / 2 + rng.uniform(0, 0.02), y, z + thick / 2)
        pieces += [replace(p, solid=p.solid.rotate((0, 0, turn)).translate(at)) for p in book]
        z += thick + 0.0005
    return tuple(pieces)


def _book(size: Point, colour: Colour, title: str, name: str) -> Pieces:
    """A closed book about the origin that lies flat, its spine towards -x with the title on it."""
    deep, long, thick = size
    spine = moulded(rounded_outline(deep, thick, 0.004), long, "y", 0.0, 0.0004, 1)
    cover = spine - box((deep, long + 1, thick - 0.005), (0.005, 0, 0))
    pages = box((deep - 0.010, long - 0.006, thick - 0.005), (0.0, 0, 0))
    cloth = Material(f"{name}_cover", colour, "paper", 700.0)
    paper = textured(f"{name}_pages", "paper", 750.0, textures.page_edges((0.90, 0.87, 0.80)), 0.04)
    ink = (0.95, 0.92, 0.84) if sum(colour) < 1.6 else (0.15, 0.14, 0.13)
    tall = thick * 0.62
    title_ink = printed(f"{name}_title", textures.label([title], colour, ink, long * 0.8 / tall, None, False, 96))
    return (
        Piece(name, cover, cloth),
        Piece(f"{name}_pages", pages, paper),
        Piece(f"{name}_title", box((0.0005, long * 0.8, tall), (-deep / 2, 0, 0)), title_ink),
    )


def _bedside_drawer(s: _Bedside, rng: Rng) -> Pieces:
    """The drawer: a front (plain, framed or grooved) with knobs and a keyhole, a wooden box and its runners."""
    inner, low, high = s.width - 2 * _PANEL, s.shelf + _PANEL / 2, s.height - 0.022
    wide, tall, middle = inner - 0.005, high - low - 0.005, (high + low) / 2
    front_x = -s.depth / 2
    front = round_box((0.018, wide, tall), 0.0025, (front_x + 0.0095, 0, middle), 16)
    style = str(rng.choice(["plain", "framed", "grooved"]))
    if style == "framed":
        front -= box((0.012, wide - 0.07, tall - 0.07), (front_x, 0, middle), 0.005)
    if style == "grooved":
        groove = rod(0.0022, wide * 2, "y", (front_x + 0.0002, 0, middle), segments=12)
        front -= repeated(groove, (0, 0, tall / 5), 4)
    profile = np.array([[0, 0], [8, 0], [8, 1.5], [4.5, 4], [5, 14], [11, 17], [14, 21], [13.5, 25], [9, 28], [0, 29]])
    knob = lathe(profile * 1e-3 * rng.uniform(0.9, 1.1)).rotate((0, -90, 0))
    face = front_x + (0.006 if style == "framed" else 0.0005)
    places = [(face, 0.0, middle)] if rng.random() < 0.5 else [(face, k * wide * 0.26, middle) for k in (-1, 1)]
    rose = plate(rounded_outline(0.013, 0.026, 0.006), 0.003, "x", face, 0.0008)
    keyhole = union((rod(0.0022, 0.02, "x", (face, 0, 0.003)), box((0.02, 0.0018, 0.009), (face, 0, -0.002))))
    lock = (rose - keyhole).translate((0, 0 if len(places) == 2 else wide * 0.36, middle))
    dark = Material("keyhole", (0.05, 0.05, 0.05), "metal", 7850.0)
    behind = box((0.001, 0.006, 0.014), (face - 0.0004, 0 if len(places) == 2 else wide * 0.36, middle - 0.001))
    return (
        Piece("drawer_front", front, s.lacquer),
        Piece("knob", union(knob.translate(p) for p in places), s.metal),
        Piece("lock", lock, s.metal),
        Piece("keyhole", behind - lock, dark),
        *_drawer_box(s, wide, tall, front_x + 0.0185, low),
    )


def _drawer_box(s: _Bedside, wide: float, tall: float, x: float, low: float) -> Pieces:
    """The box behind a drawer's front that ends at `x`, with lining paper and steel runners."""
    long, out, wall, z = s.depth - 0.055, wide - 0.022, 0.010, low + 0.008
    high = tall * 0.70
    shell = box((long, out, high), (x + long / 2, 0, z + high / 2), 0.0015)
    shell -= box((long - 2 * wall, out - 2 * wall, high), (x + long / 2, 0, z + high / 2 + 0.007))
    steel = Material("drawer_steel", (0.70, 0.71, 0.73), "metal", 7850.0)
    rails = pair(box((long * 0.95, 0.004, 0.008), (x + long * 0.48, 0, _runner(s)), 0.0008), "y", out / 2 + 0.002)
    tints = textures.shade(s.lacquer.colour, 0.9), textures.shade(s.lacquer.colour, 0.78, 0.05)
    sheet = textured("lining", "paper", 800.0, textures.stripes(tints, 6), 0.12)
    floor = box((long - 2 * wall - 0.002, out - 2 * wall - 0.002, 0.0008), (x + long / 2, 0, z + 0.0074))
    return Piece("drawer_box", shell, s.wood), Piece("drawer_runner", rails, steel), Piece("lining", floor, sheet)


def _bedside_contents(s: _Bedside, rng: Rng) -> Pieces:
    """What lies in the drawer: a notebook, a pencil, a tin of sweets."""
    front, z = -s.depth / 2 + 0.035, s.shelf + _PANEL / 2 + 0.0165
    book = _book((0.10, 0.145, 0.014), _SPINES[int(rng.integers(len(_SPINES)))], "NOTES", "notebook")
    at = (front + 0.09, s.width * 0.14, z + 0.007)
    turn = rng.uniform(-15, 15)
    pencil_at = (front + 0.10, -s.width * 0.06, z + 0.004)
    wood = Material("pencil", (0.86, 0.62, 0.16), "wood", 600.0)
    tin = rod(0.034, 0.022, "z", (front + 0.075, -s.width * 0.22, z + 0.0112), 0.002)
    seam = (front + 0.075, -s.width * 0.22, z + 0.016)
    tin -= rod(0.035, 0.0008, "z", seam) - rod(0.0335, 0.002, "z", seam)
    return (
        *(replace(p, solid=p.solid.rotate((0, 0, turn)).translate(at)) for p in book),
        Piece("pencil", rod(0.0036, 0.15, "x", pencil_at, 0.001, 6), wood),
        Piece("tin", tin, s.metal),
    )


@dataclass(frozen=True)
class _Cabinet:
    """Measures of a filing cabinet, metres, and its materials."""

    width: float
    depth: float
    height: float
    header: float
    """Height of the strip above the drawers."""
    sheet: Material
    dark: Material
    chrome: Material
    rubber: Material

    @property
    def face(self) -> float:
        """x of the carcass's front; the drawers' fronts lie before it."""
        return -self.depth / 2 + 0.0205

    @property
    def low(self) -> float:
        """Height of the lowest drawer's underside."""
        return 0.062

    @property
    def step(self) -> float:
        """From one drawer to the next."""
        return (self.height - self.header - self.low) / 3


def filing_cabinet(seed: int) -> ObjectModel:
    """The filing cabinet of a seed: sheet steel, three drawers (the top one is scored), a lock with its key.

    The front faces -x; the drawers open by positive states.
    """
    rng = np.random.default_rng([seed, 212])
    width, depth, height = np.array([0.46, 0.60, 0.95]) * rng.uniform(0.94, 1.06, 3)
    paint = _ENAMELS[int(rng.integers(len(_ENAMELS)))]
    c = _Cabinet(
        width,
        depth,
        height,
        height * rng.uniform(0.048, 0.058),
        textured("enamelled_steel", "metal", 7850.0, textures.speckle(rng, paint, 0.02), 0.10),
        Material("dark_steel", textures.shade(paint, 0.45), "metal", 7850.0),
        textured("chrome", "metal", 7850.0, textures.brushed_metal(rng, (0.74, 0.75, 0.77)), 0.05),
        Material("rubber", (0.10, 0.10, 0.11), "rubber", 1200.0),
    )
    subjects = rng.choice([["A - H", "I - Q", "R - Z"], ["2019", "2020", "2021"], ["INVOICES", "STAFF", "PLANS"]])
    root = Link("heavy furniture_body", (*_cabinet_carcass(c), *_cabinet_front(c, paint, rng), *_cabinet_rear(c, rng)))
    slide, drawers = Hinge("prismatic", "link_3", (-1, 0, 0), (0, 0, 0), 0.0, depth * 0.70), []
    for k in range(3):
        pieces = (*_file_front(c, 2 - k, str(subjects[k]), rng), *_file_box(c, 2 - k))
        drawers.append(Link("slider drawer", pieces + (_hanging_files(c, 2, rng) if k == 0 else ()), slide))
    return ObjectModel("filing_cabinet", "StorageFurniture", (*drawers, root), 0, seed)


def _cabinet_carcass(c: _Cabinet) -> Pieces:
    """The folded steel shell with its front flange and cross rails, drawer runners, plinth and levelling feet."""
    bottom, deep = 0.055, c.depth / 2 - c.face
    middle = ((c.face + c.depth / 2) / 2, 0.0, (bottom + c.height) / 2)
    shell = round_box((deep, c.width, c.height - bottom), 0.006, middle, 16)
    flange = 0.016
    shell -= box((deep - 2 * _STEEL_SHEET, c.width - 2 * _STEEL_SHEET, c.height - bottom - 2 * _STEEL_SHEET), middle)
    for k in range(3):
        z0, z1 = c.low + k * c.step, c.low + (k + 1) * c.step
        shell -= box((0.02, c.width - 2 * flange, z1 - z0 - flange), (c.face, 0, (z0 + z1) / 2))
    slots = box((0.02, c.width * 0.3, 0.006), (c.depth / 2, 0, c.height - 0.11))
    shell -= repeated(slots, (0, 0, 0.014), 7)
    rails = union(
        box((deep - 0.03, 0.010, 0.030), (middle[0], k * (c.width / 2 - 0.0065), _file_runner(c, n)), 0.002)
        - box((deep, 0.010, 0.020), (middle[0], k * (c.width / 2 - 0.0105), _file_runner(c, n)))
        for k in (-1, 1)
        for n in range(3)
    )
    plinth = box((deep - 0.04, c.width - 0.03, 0.046), (middle[0] + 0.012, 0, 0.036), 0.003)
    plinth -= box((deep - 0.043, c.width - 0.033, 0.05), (middle[0] + 0.012, 0, 0.033))
    foot = lathe([[0.0, 0.0], [0.018, 0], [0.020, 0.002], [0.020, 0.006], [0.006, 0.009], [0.006, 0.058], [0, 0.058]])
    feet = corners(foot.translate((middle[0] + 0.012, 0, 0)), "xy", deep / 2 - 0.06, c.width / 2 - 0.05)
    return (
        Piece("cabinet_shell", shell, c.sheet),
        Piece("runner", rails, c.chrome),
        Piece("plinth", plinth, c.sheet),
        Piece("foot", feet - shell, c.rubber),
    )


def _file_runner(c: _Cabinet, n: int) -> float:
    """Height of the runners of drawer `n`, counted from below."""
    return c.low + (n + 0.42) * c.step


def _cabinet_front(c: _Cabinet, paint: Colour, rng: Rng) -> Pieces:
    """The strip above the drawers with the maker's plate, the lock and the key in it."""
    tall = c.header - 0.004
    z, face = c.height - 0.001 - tall / 2, -c.depth / 2
    strip = round_box((0.026, c.width, tall), 0.004, (face + 0.013, 0, z), 16)
    y = -c.width * 0.40  # to the right of someone before it
    cylinder = rod(0.011, 0.006, "x", (face - 0.002, y, z), 0.0012, 32)
    keyway = box((0.02, 0.0016, 0.010), (face - 0.006, y, z))
    ring = rod(0.0145, 0.0020, "x", (face - 0.0002, y, z), 0.0006, 32)
    blade = box((0.026, 0.0015, 0.0075), (face - 0.011, y, z), 0.0003)
    bow = plate(rounded_outline(0.024, 0.023, 0.009), 0.0024, "y", 0.0, 0.0006) - rod(0.004, 0.01, "y", (-0.005, 0, 0))
    maker, ground = str(rng.choice(["ARCHIVO", "FREEART 21", "KARTEI & CO"])), textures.shade(paint, 0.92)
    words = textures.label([maker], ground, textures.shade(paint, 0.25), 4.6, height=128)
    badge = textured("maker_plate", "metal", 2700.0, words)
    high = tall * 0.52
    return (
        Piece("header", strip, c.sheet),
        Piece("lock", (cylinder - keyway) + ring, c.chrome),
        Piece("key", blade + bow.translate((face - 0.033, y, z)), c.chrome),
        Piece("maker_plate", box((0.001, high * 4.6, high), (face, c.width * 0.26, z), 0.0002), badge),
    )


def _cabinet_rear(c: _Cabinet, rng: Rng) -> Pieces:
    """Screws and a type label on the back."""
    screws = union(
        screw(0.005, "x", (c.depth / 2, y * (c.width / 2 - 0.022), z))
        for y in (-1, 1)
        for z in np.linspace(0.10, c.height - 0.03, 4)
    )
    text = ["TYPE FC-3", "STEEL 0.8 MM", "DO NOT OPEN TWO DRAWERS"]
    label = printed("type_label", textures.label(text, (0.93, 0.93, 0.90), (0.12, 0.12, 0.14), 1.9, rng))
    sticker = box((0.0006, 0.115, 0.06), (c.depth / 2 + 0.0001, c.width * 0.22, c.height * 0.70))
    return Piece("rear_screws", screws, c.chrome), Piece("type_label", sticker, label)


def _file_front(c: _Cabinet, n: int, subject: str, rng: Rng) -> Pieces:
    """The pressed front of drawer `n`: a sunk grip with a lip, a thumb latch, and a card in its holder."""
    tall, face = c.step - 0.004, -c.depth / 2
    z = c.low + (n + 0.5) * c.step
    pan = round_box((0.0195, c.width - 0.002, tall), 0.004, (face + 0.010, 0, z), 16)
    pan -= box((0.018, c.width - 0.006, tall - 0.004), (face + 0.0112, 0, z))
    wide, grip = 0.165, z + tall * 0.12
    mouth = moulded(rounded_outline(wide, 0.048, 0.014), 0.03, "x", face, 0.001, 1).translate((0, 0, grip))
    cup = round_box((0.034, wide + 0.006, 0.058), 0.012, (face + 0.0135, 0, grip), 20)
    cup -= round_box((0.034, wide + 0.002, 0.054), 0.011, (face + 0.0120, 0, grip), 20)
    cup = cup.trim_by_plane((1, 0, 0), face + 0.0012)
    lip = tube([[face - 0.001, y, grip + 0.0245] for y in np.linspace(-wide / 2 + 0.008, wide / 2 - 0.008, 5)], 0.0035)
    latch = round_box((0.008, 0.026, 0.014), 0.0025, (face, -wide / 2 - 0.026, grip), 12)
    card_z, high = z + tall * 0.34, 0.034
    frame = box((0.0030, high * 2.6 + 0.010, high + 0.010), (face - 0.0010, 0, card_z), 0.0008)
    opening = box((0.02, high * 2.6 - 0.004, high - 0.004), (face, 0, card_z + 0.002))
    words = textures.label([subject], (0.95, 0.94, 0.89), (0.12, 0.12, 0.16), 2.6, None, False, 128)
    card = printed(f"card_{n}", words)
    paper = box((0.0010, high * 2.6 - 0.004, high - 0.004), (face - 0.0005, 0, card_z + 0.002))
    rivets = union(screw(0.0028, "x", (face - 0.0024, k * (high * 1.3 + 0.0025), card_z), -1, 12) for k in (-1, 1))
    return (
        Piece("drawer_front", pan - mouth, c.sheet),
        Piece("handle", cup - (pan - mouth), c.dark),
        Piece("handle_lip", lip, c.chrome),
        Piece("latch", latch - pan, c.dark),
        Piece("card_frame", frame - opening, c.chrome),
        Piece("card_rivets", rivets - frame, c.chrome),
        Piece("card", paper, card),
    )


def _file_box(c: _Cabinet, n: int) -> Pieces:
    """The sheet steel box of drawer `n`, its runners, and the two rails that folders hang on."""
    t, z0 = _STEEL_SHEET, c.low + n * c.step + 0.018
    x0, x1 = -c.depth / 2 + 0.0185, c.depth / 2 - 0.035
    wide, high = c.width - 0.050, c.step * 0.66
    middle = ((x0 + x1) / 2, 0.0, z0 + high / 2)
    sides = box((x1 - x0, wide, high), middle)
    sides -= box((x1 - x0 - 2 * t, wide - 2 * t, high), (*middle[:2], middle[2] + t))
    holes = repeated(rod(0.016, 1.0, "y", (middle[0], 0, z0 + high * 0.80), segments=24), (0.11, 0, 0), 4)
    runner_z = _file_runner(c, n)
    rails = pair(box((x1 - x0 - 0.01, 0.0125, 0.016), (middle[0] - 0.005, 0, runner_z), 0.001), "y", wide / 2 + 0.0062)
    bars = pair(box((x1 - x0 - 0.004, 0.004, 0.012), (middle[0], 0, z0 + high + 0.004), 0.0006), "y", wide / 2 - 0.010)
    posts = union(
        box((0.010, 0.004, 0.020), (x, k * (wide / 2 - 0.010), z0 + high - 0.004))
        + box((0.010, 0.012, 0.004), (x, k * (wide / 2 - 0.006), z0 + high - 0.012))
        for k in (-1, 1)
        for x in (x0 + 0.02, x1 - 0.02)
    )
    return (
        Piece("drawer_box", sides - holes, c.sheet),
        Piece("drawer_runner", rails, c.chrome),
        Piece("file_bar", bars + posts, c.chrome),
    )


def _hanging_files(c: _Cabinet, n: int, rng: Rng) -> Pieces:
    """Hanging folders with lettered tabs in drawer `n`."""
    z0, high = c.low + n * c.step + 0.018, c.step * 0.66
    wide, count = c.width - 0.050, int(rng.integers(9, 13))
    manila = [(0.80, 0.70, 0.48), (0.42, 0.50, 0.44), (0.62, 0.64, 0.66)][int(rng.integers(3))]
    xs = np.linspace(-c.depth / 2 + 0.06, c.depth / 2 - 0.10, count) + rng.uniform(-0.006, 0.006, count)
    folders, tabs, hangers = [], [], []
    for k, x in enumerate(xs):
        tilt = rng.uniform(-0.06, 0.06)
        leaf = box((0.004, wide - 0.032, high * 0.80), (x, 0, z0 + high * 0.575), 0.0008)
        folders.append(tilted(leaf, "y", tilt, (x, 0, z0 + high)))
        hangers.append(box((0.0024, wide - 0.014, 0.0030), (x, 0, z0 + high + 0.0112), 0.0004))
        hangers += [box((0.0024, 0.010, high * 0.06), (x, k * (wide / 2 - 0.024), z0 + high * 0.985)) for k in (-1, 1)]
        tab = box((0.0012, 0.055, 0.020), (x, wide * (0.28 - 0.28 * (k % 3)), z0 + high * 0.975 + 0.009), 0.0002)
        tabs.append(tilted(tab, "y", tilt, (x, 0, z0 + high)))
    spine = box((xs[-1] - xs[0], wide - 0.06, 0.003), ((xs[0] + xs[-1]) / 2, 0, z0 + high * 0.25))
    paper = Material("folder", manila, "paper", 700.0)
    letters = printed("tab", textures.label(["FILE"], (0.96, 0.95, 0.90), (0.2, 0.2, 0.25), 2.7, None))
    wire = Material("hanger", (0.55, 0.56, 0.58), "metal", 7850.0)
    leaves = union([*folders, spine])
    return (
        Piece("folder", leaves, paper),
        Piece("hanger", union(hangers) - leaves, wire),
        Piece("folder_tab", union(tabs) - leaves, letters),
    )
