"""Displays: a desk monitor that tilts, one that turns upright, and a portable one with a folding stand."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from manifold3d import Manifold

from generator import textures
from generator.model import ABS, STEEL, Hinge, Link, Material, ObjectModel, Piece, Pieces, Point, Rng, printed, textured
from generator.shapes import (
    box,
    moulded,
    pair,
    plate,
    repeated,
    rod,
    round_box,
    rounded_outline,
    screw,
    smooth_outline,
    tapered,
    text_outline,
    tube,
    union,
)
from generator.textures import Colour, Image

_NIGHTS = (
    (0.135, 0.135, 0.140),
    (0.210, 0.213, 0.220),
    (0.150, 0.163, 0.195),
    (0.205, 0.190, 0.178),
    (0.150, 0.175, 0.170),
)
_DAYS = (
    ((0.78, 0.79, 0.80), (0.60, 0.61, 0.63)),
    ((0.92, 0.92, 0.91), (0.80, 0.80, 0.80)),
    ((0.24, 0.25, 0.27), (0.62, 0.12, 0.12)),
    ((0.80, 0.74, 0.64), (0.55, 0.50, 0.43)),
    ((0.46, 0.52, 0.60), (0.80, 0.81, 0.82)),
)
_GREYS = ((0.74, 0.74, 0.73), (0.60, 0.62, 0.64), (0.80, 0.78, 0.74), (0.66, 0.70, 0.74), (0.53, 0.53, 0.52))
_BRANDS = ("LUMENA", "VISTA 21", "HELIOS", "ORBIT")


@dataclass(frozen=True)
class _Monitor:
    """Measures of a desk monitor, metres, its brand and its materials. The screen looks towards -x."""

    width: float
    height: float
    """Of the panel."""
    middle: float
    """Height of the panel's middle above the desk."""
    thick: float
    """Of the frame; its front lies at x = 0."""
    brand: str
    shell: Material
    stand: Material
    dark: Material
    steel: Material
    rubber: Material
    print: Colour


def tilt_monitor(seed: int) -> ObjectModel:
    """The near-black desk monitor of a seed: the panel tilts about a level axis on its neck.

    The screen looks towards -x; positive states tilt it back.
    """
    rng = np.random.default_rng([seed, 701])
    size = rng.uniform(0.94, 1.06)
    width, height = 0.540 * size, 0.326 * size * rng.uniform(0.97, 1.03)
    colour = _NIGHTS[int(rng.integers(len(_NIGHTS)))]
    m = _monitor(rng, width, height, 0.128 * rng.uniform(0.95, 1.08) + height / 2, 0.012, colour, colour)
    hinge_at = (m.thick + 0.048, 0.0, m.middle - 0.03)
    stand = Link("heavy display_base", _neck_and_foot(m, hinge_at, rng))
    hinge = Hinge("revolute", "link_1", (0, 1, 0), hinge_at, -0.09, 0.45)
    screen = Link(
        "hinge display_screen",
        (*_panel(m, 0.011, 0.022, _night_screen(rng, colour), 0.030), *_tilt_head(m, hinge_at), *_back(m, 0.030, rng)),
        hinge,
    )
    return ObjectModel("tilt_monitor", "Display", (screen, stand), 0, seed)


def pivot_monitor(seed: int) -> ObjectModel:
    """The desk monitor of a seed whose panel turns from landscape to portrait before its column.

    The screen looks towards -x; positive states turn it clockwise for someone before it.
    """
    rng = np.random.default_rng([seed, 702])
    size = rng.uniform(0.94, 1.06)
    width, height = 0.540 * size, 0.322 * size * rng.uniform(0.97, 1.03)
    colour, trim = _DAYS[int(rng.integers(len(_DAYS)))]
    middle = np.hypot(width, height) / 2 + 0.014 + rng.uniform(0.030, 0.055)
    m = _monitor(rng, width, height, float(middle), 0.010, colour, trim)
    stand = Link("heavy display_base", _column_and_foot(m, rng))
    hinge = Hinge("revolute", "link_1", (1, 0, 0), (0.0, 0.0, m.middle), 0.0, np.pi / 2)
    screen = Link(
        "hinge display_screen",
        (*_panel(m, 0.008, 0.014, _desktop(rng), 0.018), *_pivot_head(m), *_back(m, 0.018, rng)),
        hinge,
    )
    return ObjectModel("pivot_monitor", "Display", (screen, stand), 0, seed)


def _monitor(
    rng: Rng, width: float, height: float, middle: float, thick: float, colour: Colour, trim: Colour
) -> _Monitor:
    light = sum(colour) > 1.2
    return _Monitor(
        width,
        height,
        middle,
        thick,
        str(rng.choice(_BRANDS)),
        textured("shell", "plastic", ABS, textures.speckle(rng, colour, 0.05), 0.04),
        Material("stand_metal", textures.shade(trim, 0.95), "metal", 2700.0),
        Material("port_plastic", textures.shade(colour, 0.4), "plastic", ABS),
        textured("steel", "metal", STEEL, textures.brushed_metal(rng, (0.55, 0.56, 0.58)), 0.02),
        Material("rubber", (0.07, 0.07, 0.075), "rubber", 1200.0),
        (0.20, 0.20, 0.22) if light else (0.62, 0.62, 0.64),
    )


def _panel(m: _Monitor, bezel: float, chin: float, picture: Image, depth: float) -> Pieces:
    """The frame with the sunk screen, the maker's name on its chin, buttons below it; the back shell, `depth` deep."""
    frame = moulded(rounded_outline(m.width, m.height, 0.007), m.thick, "x", m.thick / 2, 0.0018)
    high, wide = m.height - bezel - chin, m.width - 2 * bezel
    frame -= box((0.003, wide, high), (0, 0, (chin - bezel) / 2))
    screen = box((0.0008, wide - 0.0004, high - 0.0004), (0.0012, 0, (chin - bezel) / 2))
    name = plate(text_outline(m.brand, chin * 0.34).mirror((1, 0)), 0.0012, "x")
    name = name.translate((0, 0, -m.height / 2 + chin * 0.5))
    button = round_box((0.006, 0.014, 0.004), 0.0012, (m.thick * 0.5, 0, -m.height / 2), 12)
    buttons = repeated(button, (0, 0.021, 0), 5).translate((0, -m.width * 0.36, 0))
    led = box((0.001, 0.009, 0.0018), (0, -m.width * 0.45, -m.height / 2 + chin * 0.30), 0.0003)
    glow = Material("power_light", [(0.85, 0.88, 0.92), (0.30, 0.70, 0.95)][len(m.brand) % 2], "plastic", ABS)
    ink = Material("brand", m.print, "plastic", ABS)
    glass = textured("screen", "plastic", 2500.0, picture)
    return _raised(
        m,
        ("screen_frame", frame, m.shell),
        ("screen", screen, glass),
        ("brand", name, ink),
        ("buttons", buttons - frame, m.dark),
        ("power_light", led - frame, glow),
        ("back_shell", _back_shell(m, depth), m.shell),
    )


def _raised(m: _Monitor, *parts: tuple[str, Manifold, Material]) -> Pieces:
    """Pieces made about the panel's middle, put at its height."""
    return tuple(Piece(name, solid.translate((0, 0, m.middle)), material) for name, solid, material in parts)


def _back_shell(m: _Monitor, depth: float) -> Manifold:
    """A hollow, tapered shell with vents through it and a recess for the plugs."""

    def hump(less: float) -> Manifold:
        low = rounded_outline(m.width * 0.93 - 2 * less, m.height * 0.90 - 2 * less, 0.016)
        mid = rounded_outline(m.width * 0.50 - 2 * less, m.height * 0.60 - 2 * less, 0.022)
        top = rounded_outline(m.width * 0.48 - 2 * less, m.height * 0.57 - 2 * less, 0.020)
        at = m.thick - 0.001
        bodies = tapered(low, mid, depth - 0.003 - less, "x", at), tapered(low, top, depth + 0.001 - less, "x", at)
        return union(bodies).hull()

    outer = hump(0.0)
    shell = outer - hump(0.0025)
    recess = ((0.04, m.width * 0.40, 0.026), (m.thick + 0.026, 0, -m.height * 0.34))
    cup = box((recess[0][0] + 0.005, recess[0][1] + 0.005, recess[0][2] + 0.005), recess[1]) ^ outer
    shell = shell + cup - box(*recess)
    slit = box((0.2, 0.0028, 0.024), (m.thick + 0.1, 0, m.height * 0.345))
    shell -= repeated(slit, (0, 0.0072, 0), 2 * int(m.width * 0.55 / 0.0144))
    return shell


def _back(m: _Monitor, depth: float, rng: Rng) -> Pieces:
    """Plug sockets in their recess, screws, the maker's name and the rating plate."""
    floor, z = m.thick + 0.0035, -m.height * 0.34
    rims, cores = [], []
    for y, wide, high in (
        (-0.075, 0.021, 0.017),
        (-0.030, 0.015, 0.0065),
        (0.0, 0.015, 0.0065),
        (0.030, 0.0165, 0.006),
    ):
        rim = box((0.006, wide, high), (floor + 0.003, y, z))
        rims.append(rim - box((0.02, wide - 0.002, high - 0.002), (floor, y, z)))
        cores.append(box((0.004, wide - 0.002, max(high * 0.30, 0.0015)), (floor + 0.002, y, z)))
    lining = box((0.0008, m.width * 0.40 - 0.001, 0.025), (floor - 0.0004, 0, z))
    face = m.thick + depth
    screws = union(
        screw(0.0042, "x", (m.thick + 0.0032, y * m.width * 0.44, zz * m.height * 0.42))
        for y in (-1, 1)
        for zz in (-1, 1)
    )
    name = plate(text_outline(m.brand, m.height * 0.045), 0.0016, "x", face + 0.0004)
    name = name.translate((0, 0, m.height * 0.185))
    text = [f"MODEL {m.brand[:2]}-{int(rng.integers(200, 299))}", "12 V = 3.0 A", "MADE OF CODE"]
    paper = textures.shade(m.shell.texture[0, 0] / 255.0 if m.shell.texture is not None else m.print, 1.25, 0.03)
    rating = printed("rating_plate", textures.label(text, paper, m.print, 2.0, rng))
    sticker = box((0.0005, 0.068, 0.034), (face + 0.0001, m.width * 0.155, -m.height * 0.13))
    return _raised(
        m,
        ("sockets", union(rims), m.steel),
        ("socket_cores", union([*cores, lining]), m.dark),
        ("back_screws", screws, m.steel),
        ("back_brand", name, m.stand),
        ("rating_plate", sticker, rating),
    )


def _tilt_head(m: _Monitor, hinge_at: Point) -> Pieces:
    """The panel's half of the tilting hinge: a mount with two cheeks, and the pin's heads."""
    x, _, z = hinge_at
    face = m.thick + 0.030
    mount = round_box((0.007, 0.104, 0.104), 0.003, (face + 0.0015, 0, z), 16)
    cheeks = union(
        (
            rod(0.0135, 0.008, "y", (x, k * 0.0280, z), 0.001)
            + box((0.004, 0.008, 0.060), (face + 0.003, k * 0.0280, z))
        ).hull()
        for k in (-1, 1)
    )
    heads = pair(rod(0.006, 0.003, "y", (x, 0, z), 0.0008, 24), "y", 0.0330)
    screws = union(
        screw(0.004, "x", (face + 0.005, y * 0.043, z + k * 0.043), segments=16) for y in (-1, 1) for k in (-1, 1)
    )
    return (
        Piece("mount", mount + cheeks, m.shell),
        Piece("hinge_pin", heads - cheeks, m.steel),
        Piece("mount_screws", screws - mount, m.steel),
    )


def _neck_and_foot(m: _Monitor, hinge_at: Point, rng: Rng) -> Pieces:
    """A leaning neck with a hole for cables on a rectangular or round foot with rubber pads."""
    x, _, z = hinge_at
    base = x + 0.028
    outline = [
        [base - 0.020, 0.008],
        [base + 0.020, 0.008],
        [x + 0.014, z - 0.006],
        [x + 0.008, z],
        [x - 0.006, z - 0.008],
    ]
    neck = plate(smooth_outline(outline, 0.004), 0.041, "y", 0.0, 0.002)
    barrel = rod(0.0125, 0.0465, "y", hinge_at, 0.001)
    hole = plate(rounded_outline(0.020, 0.036, 0.0098), 0.3, "x", x).translate((0, 0, 0.062))
    tip = Material("foot_metal", m.stand.colour, "metal", 3200.0)
    middle = base - 0.045
    if rng.random() < 0.5:
        foot = moulded(rounded_outline(0.185, 0.235, 0.022), 0.012, "z", 0.009, 0.003).translate((middle, 0, 0))
        spots = [(sx * 0.075, sy * 0.10) for sx in (-1, 1) for sy in (-1, 1)]
    else:
        foot = rod(0.108, 0.012, "z", (middle, 0, 0.009), 0.003, 72)
        spots = [(0.085 * np.cos(a), 0.085 * np.sin(a)) for a in np.pi / 2 * np.arange(4) + np.pi / 4]
    pads = union(rod(0.009, 0.004, "z", (middle + px, py, 0.002), 0.0006, 24) for px, py in spots)
    collar = moulded(rounded_outline(0.052, 0.056, 0.010), 0.006, "z", 0.0165, 0.002).translate((base, 0, 0))
    return (
        Piece("neck", neck - hole - barrel, m.shell),
        Piece("hinge_barrel", barrel, m.dark),
        Piece("foot", foot, tip),
        Piece("collar", collar - neck, m.dark),
        Piece("foot_pads", pads - foot, m.rubber),
    )


def _pivot_head(m: _Monitor) -> Pieces:
    """The square mount on the panel's back with its screws and the turning disc."""
    face = m.thick + 0.018
    mount = round_box((0.010, 0.116, 0.116), 0.003, (face + 0.003, 0, 0), 16)
    disc = rod(0.036, 0.008, "x", (face + 0.011, 0, 0), 0.001)
    screws = union(
        screw(0.0045, "x", (face + 0.008, y * 0.047, k * 0.047), segments=16) for y in (-1, 1) for k in (-1, 1)
    )
    mark = box((0.001, 0.003, 0.010), (face + 0.0082, 0, 0.046), 0.0002)
    red = Material("turn_mark", (0.75, 0.15, 0.12), "plastic", ABS)
    return _raised(
        m,
        ("mount", mount, m.stand),
        ("turning_disc", disc - mount, m.steel),
        ("mount_screws", screws - mount, m.steel),
        ("turn_mark", mark - mount, red),
    )


def _column_and_foot(m: _Monitor, rng: Rng) -> Pieces:
    """A column with a carriage that holds the panel, a carrying loop, a cable ring, a scale, and a foot with a tray."""
    x, near = m.thick + 0.083, m.thick + 0.018 + 0.0155
    disc = rod(0.040, 0.010, "x", (near + 0.0055, 0, m.middle), 0.0015)
    hub, end = rod(0.020, 0.004, "x", (near + 0.010, 0, m.middle)), box((0.004, 0.056, 0.070), (x - 0.024, 0, m.middle))
    arm = (hub + end).hull()
    top = m.middle + rng.uniform(0.10, 0.13)
    post = moulded(rounded_outline(0.036, 0.064, 0.012), top - 0.010, "z", (top + 0.010) / 2, 0.003)
    post = post.translate((x, 0, 0))
    sleeve = moulded(rounded_outline(0.048, 0.076, 0.016), 0.105, "z", m.middle, 0.003).translate((x, 0, 0))
    slot = round_box((0.06, 0.016, (m.middle - 0.16) * 0.8), 0.007, (x, 0, 0.06 + (m.middle - 0.16) * 0.4), 16)
    arch = [(x, 0.022 * np.cos(a), top - 0.004 + 0.030 * np.sin(a)) for a in np.linspace(0, np.pi, 17)]
    loop = tube(arch, 0.0055, 12)
    ring_z = 0.085 + (m.middle - 0.16) * 0.8
    oval = [(x + 0.030 + 0.016 * np.cos(a), 0.020 * np.sin(a), ring_z) for a in 2 * np.pi * np.arange(24) / 24]
    ring = tube(oval, 0.0030, 8, True)
    scale = printed("scale", _scale(m.stand.colour, m.print))
    strips = pair(box((0.012, 0.0004, top - m.middle - 0.062), (x, 0, (top + m.middle + 0.05) / 2)), "y", 0.032)
    metal = Material("foot_metal", m.stand.colour, "metal", 3000.0)
    middle = x - 0.055
    foot = moulded(rounded_outline(0.220, 0.270, 0.024), 0.012, "z", 0.009, 0.003).translate((middle, 0, 0))
    tray = moulded(rounded_outline(0.016, 0.150, 0.007), 0.010, "z", 0.015, 0.0015).translate((middle - 0.075, 0, 0))
    pads = union(
        rod(0.010, 0.004, "z", (middle + px * 0.088, py * 0.112, 0.002), 0.0006, 24) for px in (-1, 1) for py in (-1, 1)
    )
    return (
        Piece("column", post - slot, m.stand),
        Piece("carriage", sleeve - post, m.shell),
        Piece("arm", arm - sleeve - post, m.shell),
        Piece("turntable", disc - arm, m.dark),
        Piece("carrying_loop", loop - post, m.stand),
        Piece("cable_ring", ring - post, m.dark),
        Piece("scale", strips, scale),
        Piece("foot", foot - tray, metal),
        Piece("foot_pads", pads - foot, m.rubber),
    )


@dataclass(frozen=True)
class _Portable:
    """Measures of a portable display, metres, and its materials. It stands upright about the origin, facing -x."""

    width: float
    height: float
    thick: float
    pocket: tuple[float, float]
    """Width and height of the stand's recess."""
    top: float
    """Height of the recess's upper rim."""
    shell: Material
    dark: Material
    steel: Material
    rubber: Material
    colour: Colour
    ink: Colour

    @property
    def hinge(self) -> Point:
        """A point of the stand's axis."""
        return self.thick / 2 - 0.0024, 0.0, self.top - 0.0058


def folding_display(seed: int) -> ObjectModel:
    """The portable grey display of a seed, with electronic paper; its stand folds into a recess of the back.

    The screen looks towards -x; the stand opens by positive states.
    """
    rng = np.random.default_rng([seed, 703])
    width, height = np.array([0.352, 0.228]) * rng.uniform(0.95, 1.06, 2)
    colour = _GREYS[int(rng.integers(len(_GREYS)))]
    p = _Portable(
        width,
        height,
        0.0125 * rng.uniform(0.95, 1.08),
        (width * rng.uniform(0.66, 0.76), height * rng.uniform(0.52, 0.58)),
        height * rng.uniform(0.10, 0.16),
        textured("shell", "metal", 2000.0, textures.speckle(rng, colour, 0.03), 0.04),
        Material("dark_plastic", textures.shade(colour, 0.45), "plastic", ABS),
        textured("steel", "metal", STEEL, textures.brushed_metal(rng, textures.shade(colour, 1.05)), 0.02),
        Material("rubber", textures.shade(colour, 0.35), "rubber", 1200.0),
        colour,
        textures.shade(colour, 0.28),
    )
    panel = Link("heavy display_panel", (*_tablet(p, rng), *_tablet_edges(p), *_tablet_back(p, rng)))
    stand = Link("hinge display_stand", _kickstand(p, rng), Hinge("revolute", "link_1", (0, -1, 0), p.hinge, 0.0, 2.2))
    return ObjectModel("folding_display", "Display", (stand, panel), 0, seed)


def _tablet(p: _Portable, rng: Rng) -> Pieces:
    """The slab, its screen of electronic paper, the maker's name and touch keys on its chin."""
    slab = moulded(rounded_outline(p.width, p.height, 0.012), p.thick, "x", 0.0, 0.0022, 3)
    bezel, chin, front = 0.009, 0.022, -p.thick / 2
    wide, high, z = p.width - 2 * bezel, p.height - bezel - chin, (chin - bezel) / 2
    slab -= box((0.0024, wide, high), (front, 0, z))
    pocket = plate(rounded_outline(*p.pocket, 0.008), 0.0096, "x", p.thick / 2)
    notch = rod(0.014, 0.0096, "x", (p.thick / 2, 0, p.top - p.pocket[1] + 0.003))
    slab -= pocket.translate((0, 0, p.top - p.pocket[1] / 2)) + notch
    slit = box((0.004, 0.0022, 0.014), (p.thick / 2, 0, (p.height / 2 + p.top) / 2 + 0.012))
    slab -= repeated(slit, (0, 0.0056, 0), 16)
    paper = textures.shade(p.colour, 1.06)
    glass = textured("screen", "plastic", 2200.0, _page(rng, paper, p.ink, wide / high))
    brand = str(rng.choice(_BRANDS))
    name = plate(text_outline(brand, chin * 0.30).mirror((1, 0)), 0.0008, "x", front)
    name = name.translate((0, 0, -p.height / 2 + chin / 2))
    key = rod(0.0032, 0.0008, "x", (front, -p.width * 0.40, -p.height / 2 + chin / 2), 0.0, 24)
    keys = repeated(key, (0, 0.013, 0), 3)
    back = plate(text_outline(brand, p.height * 0.05), 0.0008, "x", p.thick / 2)
    back = back.translate((0, p.width * 0.36, (p.height / 2 + p.top) / 2 + 0.012))
    ink = Material("print", p.ink, "plastic", ABS)
    return (
        Piece("slab", slab, p.shell),
        Piece("screen", box((0.0008, wide - 0.0004, high - 0.0004), (front + 0.0007, 0, z)), glass),
        Piece("brand", name - slab, ink),
        Piece("touch_keys", keys - slab, ink),
        Piece("back_brand", back - slab, p.steel),
    )


def _tablet_edges(p: _Portable) -> Pieces:
    """Sockets on one edge, rocker and power key on the other."""
    y, sockets, cores = p.width / 2, [], []
    for z, long in ((-0.02, 0.0095), (0.0, 0.0095), (0.022, 0.0125)):
        sockets.append(plate(rounded_outline(0.0042, long, 0.0018), 0.0016, "y", y + 0.0002).translate((0, 0, z)))
        core = plate(rounded_outline(0.0026, long - 0.0018, 0.0011), 0.0022, "y", y + 0.0002)
        cores.append(core.translate((0, 0, z)))
    keys = [round_box((0.004, 0.003, long), 0.0010, (0, -y, z), 12) for z, long in ((0.03, 0.020), (0.055, 0.010))]
    rims, core = union(sockets), union(cores)
    return (
        Piece("sockets", rims - core, p.steel),
        Piece("socket_cores", core, p.dark),
        Piece("edge_keys", union(keys), p.dark),
    )


def _tablet_back(p: _Portable, rng: Rng) -> Pieces:
    """Fixed knuckles of the hinge, magnets and the rating plate in the recess, corner screws, rubber feet."""
    x, _, z = p.hinge
    floor = p.thick / 2 - 0.0048
    knuckles = union(
        rod(0.0022, 0.012, "y", (x, y, z), 0.0002, 20) + box((0.0030, 0.012, 0.0056), (x, y, z + 0.0030))
        for side in (-1, 1)
        for y in (side * p.pocket[0] * 0.32 - 0.0220, side * p.pocket[0] * 0.32 + 0.0220)
    )
    middle = p.top - p.pocket[1] / 2
    magnets = pair(
        rod(0.005, 0.0006, "x", (floor + 0.0001, 0, middle - p.pocket[1] * 0.30), 0, 24), "y", p.pocket[0] * 0.40
    )
    text = [f"EP-{int(rng.integers(130, 170))} PORTABLE DISPLAY", "5 V = 2.0 A", "MADE OF CODE"]
    rating = printed("rating_plate", textures.label(text, textures.shade(p.colour, 1.12, 0.02), p.ink, 2.4, rng))
    sticker = box((0.0003, p.pocket[0] * 0.44, p.pocket[0] * 0.44 / 2.4), (floor + 0.0001, 0, middle))
    corners = [(sy * (p.width / 2 - 0.011), sz * (p.height / 2 - 0.011)) for sy in (-1, 1) for sz in (-1, 1)]
    screws = union(screw(0.0026, "x", (p.thick / 2 - 0.0008, y, zz), segments=16) for y, zz in corners)
    feet = pair(round_box((0.006, 0.040, 0.003), 0.0012, (0, 0, -p.height / 2), 12), "y", p.width * 0.33)
    return (
        Piece("fixed_knuckles", knuckles, p.steel),
        Piece("magnets", magnets, p.dark),
        Piece("rating_plate", sticker, rating),
        Piece("corner_screws", screws, p.dark),
        Piece("feet", feet, p.rubber),
    )


def _kickstand(p: _Portable, rng: Rng) -> Pieces:
    """The stand: a thin leaf with a grip hole, its knuckles, a printed line and a rubber edge."""
    x, _, z = p.hinge
    gap, wide = 0.0007, p.pocket[0] - 0.0014
    long = p.top - p.pocket[1] + gap
    high = (z - 0.0040) - long
    leaf = moulded(rounded_outline(wide, high, 0.007), 0.0040, "x", x, 0.0008).translate((0, 0, long + high / 2))
    grip = moulded(rounded_outline(wide * 0.26, 0.018, 0.0085), 0.1, "x", x).translate((0, 0, long + high * 0.24))
    knuckles = union(
        (rod(0.0022, 0.031, "y", (x, k * p.pocket[0] * 0.32, z), 0.0002, 20))
        + box((0.0026, 0.031, 0.0060), (x, k * p.pocket[0] * 0.32, z - 0.0030))
        for k in (-1, 1)
    )
    edge = box((0.0044, wide * 0.55, 0.0044), (x, 0, long + 0.0019), 0.0003)
    text = str(rng.choice(["FOLD  0 - 125", "OPEN TO STAND", "STAND SIDE"]))
    picture = textures.label([text], p.colour, textures.shade(p.colour, 0.55), 7.0, None, False, 96)
    words = textured("stand_print", "plastic", ABS, picture)
    line = box((0.0003, wide * 0.42, wide * 0.06), (x + 0.0020, 0, long + high * 0.70))
    thread = rod(0.0032, 0.0044, "x", (x, wide * 0.40, long + high * 0.5), 0.0, 24)
    bush = rod(0.0055, 0.0044, "x", (x, wide * 0.40, long + high * 0.5), 0.0002, 24) - thread
    bore = rod(0.0055, 0.1, "x", (x, wide * 0.40, long + high * 0.5), 0.0, 24)
    return (
        Piece("stand_leaf", leaf - grip - edge - bore, p.shell),
        Piece("stand_knuckles", knuckles - leaf, p.steel),
        Piece("stand_edge", edge, p.rubber),
        Piece("stand_print", line, words),
        Piece("tripod_bush", bush, p.steel),
    )


def _night_screen(rng: Rng, colour: Colour) -> Image:
    """A dark screen: a clock, a page of program text, or nothing but a sheen."""
    h, w = 360, 640
    v, u = np.mgrid[0:h, 0:w] / h
    sheen = 0.75 + 0.30 * np.exp(-(((u - v * 0.5 - 0.55) / 0.30) ** 2)) + 0.1 * v
    picture = textures.to_uint8(np.array(colour) * sheen[..., None])
    style = int(rng.integers(3))
    grey = tuple(255 * min(1.0, 2.6 * c + 0.16) for c in colour)
    if style == 0:
        clock = f"{int(rng.integers(10, 24))}:{int(rng.integers(10, 60))}"
        (tw, _), _ = cv2.getTextSize(clock, cv2.FONT_HERSHEY_DUPLEX, 3.4, 5)
        cv2.putText(picture, clock, ((w - tw) // 2, 180), cv2.FONT_HERSHEY_DUPLEX, 3.4, grey, 5, cv2.LINE_AA)
        cv2.putText(picture, "SATURDAY 21", (w // 2 - 95, 235), cv2.FONT_HERSHEY_DUPLEX, 0.9, grey, 1, cv2.LINE_AA)
    elif style == 1:
        cv2.rectangle(picture, (0, 0), (120, h), tuple(0.7 * 255 * c for c in colour), -1)
        y = 24
        while y < h - 10:
            x = 140 + 22 * int(rng.integers(0, 4))
            for _ in range(int(rng.integers(1, 5))):
                long = int(rng.integers(18, 80))
                tint = np.array(grey) * rng.uniform(0.5, 1.0) * rng.uniform(0.8, 1.1, 3)
                cv2.rectangle(picture, (x, y), (min(x + long, w - 20), y + 5), tint.tolist(), -1)
                x += long + 8
            y += 15
        for k in range(12):
            cv2.rectangle(picture, (14, 22 + 18 * k), (14 + int(rng.integers(40, 90)), 27 + 18 * k), grey, -1)
    return picture


def _desktop(rng: Rng) -> Image:
    """A coloured desktop: hills under a sky, two windows, icons and a task bar."""
    h, w = 432, 768
    v, u = np.mgrid[0:h, 0:w] / h
    hue = rng.uniform(0, 1)
    sky = np.array([0.25 + 0.35 * hue, 0.50, 0.85 - 0.35 * hue])
    picture = sky + (np.array([0.98, 0.86, 0.70]) - sky) * np.clip(v * 1.2, 0, 1)[..., None]
    for k in range(3):
        line = 0.55 + 0.14 * k + 0.06 * np.sin(2 * np.pi * (u * rng.uniform(0.4, 0.9) + rng.uniform()))
        green = np.array([0.20, 0.50 - 0.10 * k, 0.38 - 0.08 * k])
        picture = np.where((v > line)[..., None], green, picture)
    picture = textures.to_uint8(picture)
    for k, (x, y, ww, hh) in enumerate(((90, 60, 330, 240), (380, 140, 300, 220))):
        x, y = x + int(rng.integers(-20, 20)), y + int(rng.integers(-20, 20))
        cv2.rectangle(picture, (x, y), (x + ww, y + hh), (246, 246, 248), -1)
        cv2.rectangle(picture, (x, y), (x + ww, y + 22), [(40, 90, 170), (170, 70, 50)][k], -1)
        for n in range(3):
            cv2.circle(picture, (x + ww - 14 - 18 * n, y + 11), 5, (235, 235, 235), -1, cv2.LINE_AA)
        if k == 0:
            for row in range(9):
                long = int(rng.integers(90, ww - 40))
                cv2.rectangle(
                    picture, (x + 16, y + 40 + 21 * row), (x + 16 + long, y + 48 + 21 * row), (90, 96, 110), -1
                )
        else:
            for n in range(7):
                high = int(rng.integers(30, hh - 60))
                tint = rng.uniform(60, 220, 3).tolist()
                cv2.rectangle(picture, (x + 22 + 37 * n, y + hh - 14 - high), (x + 48 + 37 * n, y + hh - 14), tint, -1)
    for n in range(5):
        cv2.rectangle(picture, (22, 24 + 62 * n), (56, 58 + 62 * n), rng.uniform(70, 240, 3).tolist(), -1)
    cv2.rectangle(picture, (0, h - 28), (w, h), (30, 34, 44), -1)
    for n in range(8):
        cv2.rectangle(picture, (12 + 32 * n, h - 23), (32 + 32 * n, h - 5), rng.uniform(90, 240, 3).tolist(), -1)
    cv2.putText(picture, "10:21", (w - 74, h - 8), cv2.FONT_HERSHEY_DUPLEX, 0.7, (235, 235, 235), 1, cv2.LINE_AA)
    return picture


def _page(rng: Rng, paper: Colour, ink: Colour, aspect: float) -> Image:
    """Electronic paper: a heading, two columns of lines, and a curve in its axes."""
    h = 480
    w = round(h * aspect)
    picture = textures.to_uint8(np.broadcast_to(np.array(paper), (h, w, 3)))
    black, grey = tuple(255 * c for c in ink), tuple(255 * (0.6 * a + 0.4 * b) for a, b in zip(paper, ink, strict=True))
    title = str(rng.choice(["HINGES AND SLIDERS", "A SHORT HISTORY OF DOORS", "NOTES ON TWO PARTS"]))
    cv2.putText(picture, title, (40, 62), cv2.FONT_HERSHEY_TRIPLEX, 1.15, black, 2, cv2.LINE_AA)
    cv2.line(picture, (40, 82), (w - 40, 82), black, 2, cv2.LINE_AA)
    half = w // 2
    for left, top, bottom in ((40, 112, h - 40), (half + 16, 112 + 190, h - 40)):
        for y in range(top, bottom, 17):
            last = rng.random() < 0.15
            long = int((half - 56) * (rng.uniform(0.3, 0.8) if last else rng.uniform(0.94, 1.0)))
            cv2.line(picture, (left, y), (left + long, y), grey, 4)
    x0, y0, ww, hh = half + 24, 112, half - 70, 160
    cv2.line(picture, (x0, y0), (x0, y0 + hh), black, 2)
    cv2.line(picture, (x0, y0 + hh), (x0 + ww, y0 + hh), black, 2)
    t = np.linspace(0, 1, 60)
    curve = 0.5 + 0.35 * np.sin(2 * np.pi * (t * rng.uniform(0.7, 1.6) + rng.uniform())) * np.exp(-t)
    points = np.stack([x0 + t * ww, y0 + hh * (1 - curve)], -1)
    cv2.polylines(picture, [np.rint(points).astype(np.int32)], False, black, 4, cv2.LINE_AA)
    return picture


def _scale(ground: Colour, ink: Colour) -> Image:
    """Height marks for a column's side."""
    picture = textures.to_uint8(np.broadcast_to(np.array(ground), (256, 48, 3)))
    for k in range(21):
        long = 30 if k % 5 == 0 else 16
        cv2.line(picture, (0, 8 + 12 * k), (long, 8 + 12 * k), tuple(255 * c for c in ink), 2)
    return picture
