"""Three memory sticks of about 6 cm: in a metal sleeve that swivels, with a flip cap, and like a pocket knife."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection

from generator import textures
from generator.model import ABS, BRASS, STEEL, Hinge, Link, Material, ObjectModel, Piece, Pieces, Rng, printed, textured
from generator.shapes import box, moulded, pair, plate, rod, rounded_outline, smooth_outline, text_outline, tube, union
from generator.textures import Colour

_RUBBER = 1150.0
_SILVER: Colour = (0.76, 0.77, 0.79)
_PLUG_LONG = 0.0122
"""How far a plug stands out of its stick."""

_STICKS = ((0.80, 0.10, 0.12), (0.10, 0.24, 0.62), (0.95, 0.56, 0.06), (0.10, 0.50, 0.30), (0.14, 0.14, 0.16))
_RUBBERS = (
    ((0.10, 0.36, 0.58), (0.93, 0.93, 0.92)),
    ((0.72, 0.12, 0.16), (0.16, 0.16, 0.17)),
    ((0.20, 0.44, 0.22), (0.94, 0.78, 0.20)),
    ((0.24, 0.24, 0.26), (0.95, 0.45, 0.10)),
    ((0.88, 0.50, 0.60), (0.97, 0.96, 0.94)),
)
_KNIVES = ((0.70, 0.71, 0.73), (0.33, 0.34, 0.36), (0.66, 0.60, 0.52), (0.17, 0.17, 0.18), (0.50, 0.54, 0.60))


def swivel_usb(seed: int) -> ObjectModel:
    """The swivel stick of a seed. Plug towards -x, rivet at the origin; the stick turns out of its sleeve over +y."""
    rng = np.random.default_rng([seed, 311])
    front, width, thick = np.array([0.0265, 0.0185, 0.0086]) * rng.uniform(0.94, 1.06, 3)
    colour = _STICKS[int(rng.integers(len(_STICKS)))]
    sleeve = Link("heavy usb_cover", _sleeve(front + _PLUG_LONG, width, thick, rng))
    hinge = Hinge("revolute", "link_1", (0, 0, -1), (0, 0, 0), 0.0, float(np.pi))
    stick = Link("hinge usb_rotation", _stick(front, width, thick, colour, rng), hinge)
    return ObjectModel("swivel_usb", "USB", (stick, sleeve), 0, seed)


def _stick(front: float, width: float, thick: float, colour: Colour, rng: Rng) -> Pieces:
    plastic = textured("stick", "plastic", ABS, textures.speckle(rng, colour, 0.06), 0.02)
    ends = [CrossSection.circle(0.003, 24).translate((0.003 - front, s * (width / 2 - 0.003))) for s in (-1, 1)]
    solid = moulded(CrossSection.batch_hull([*ends, CrossSection.circle(width / 2, 48)]), thick, "z", 0, 0.0014, 3)
    loop = CrossSection.batch_hull(
        [CrossSection.circle(r, 32).translate((x, 0)) for r, x in ((0.006, 0), (0.0037, width / 2 + 0.0022))]
    )
    solid += moulded(loop - CrossSection.circle(0.0019, 24).translate((width / 2 + 0.0026, 0)), 0.0036, "z", 0, 0.0005)
    grooves = int(rng.integers(4, 8))
    for k in range(grooves):
        x = -front + 0.0070 + k * 0.0019
        solid -= pair(rod(0.0006, thick * 2, "z", (x, 0, 0), segments=12), "y", width / 2 + 0.0001)
    solid -= rod(0.0024, thick * 2, "z", segments=32)
    size = str(rng.choice(["16 GB", "32 GB", "64 GB", "128 GB"]))
    words = printed("capacity", textures.label([size], colour, _ink_on(colour), 2.2, None, False))
    lines = ["FREEART 21", f"SN {int(rng.integers(10000, 99999))}"]
    small = printed("serial", textures.label(lines, (0.95, 0.95, 0.93), (0.1, 0.1, 0.1), 2.0, rng))
    at, half = -front * 0.665, thick / 2
    lamp = Material("lamp", (0.45, 0.85, 0.95), "plastic", ABS)
    return (
        Piece("stick", solid, plastic),
        Piece("capacity", box((front * 0.46, front * 0.21, 0.0003), (at, 0, half)), words),
        Piece("serial", box((front * 0.44, front * 0.22, 0.0003), (at, 0, -half)), small),
        Piece("lamp", rod(0.0009, 0.0008, "y", (-0.004, -width / 2, 0), 0.0002, 24), lamp),
        *_plug(_SILVER, -front, rng),
    )


def _sleeve(reach: float, width: float, thick: float, rng: Rng) -> Pieces:
    """A steel strip bent to a U over the plug, its legs riveted to the stick at the origin."""
    steel = textured("sleeve_steel", "metal", STEEL, textures.brushed_metal(rng, _SILVER), 0.02)
    sheet, inner = 0.0007, thick + 0.0006
    nose = -(np.hypot(reach, 0.006) + 0.0006)  # the plug's corners pass inside
    long = width / 2 - nose + 0.01
    bent = rounded_outline(2 * long, inner + 2 * sheet, 0.0030) - rounded_outline(2 * long - 2 * sheet, inner, 0.0023)
    strip = moulded(bent, width + 0.004, "y", 0, 0.0002, 1).translate((nose - sheet + long, 0, 0))
    corners = [CrossSection.circle(0.0025, 24).translate((nose + 0.0015, s * (width / 2 - 0.0025))) for s in (-1, 1)]
    strip ^= plate(CrossSection.batch_hull([*corners, CrossSection.circle(width / 2, 64)]), 0.05, "z")
    top, middle = inner / 2 + sheet, (nose - width * 0.35) / 2
    logo = str(rng.choice(["TWISTER", "ORBIT", "SPINNER", "COMET"]))
    letters = text_outline(logo, width * 0.30, -nose * 0.52).translate((middle - 0.001, 0))
    strip -= plate(letters, 0.0005, "z", top)
    slot = rounded_outline(0.0022, width * 0.45, 0.0010).translate((nose + 0.0052, 0))
    strip -= plate(slot, 0.004, "z", top)  # for a lanyard
    ground = textures.brushed_metal(rng, _SILVER)
    prints = textures.label(["CE  FC", "MADE OF CODE"], ground, (0.25, 0.25, 0.27), 2.2, rng, False)
    etched = textured("etching", "metal", STEEL, prints)
    below = box((width * 1.05, width * 0.48, 0.0002), (middle, 0, -top))
    shaft = rod(0.0020, inner + 2 * sheet + 0.0012, "z", segments=32)
    heads = pair(rod(0.0034, 0.0014, "z", (0, 0, 0), 0.0004, 40), "z", top + 0.0001)
    drive = pair(rod(0.0014, 0.0010, "z", (0, 0, 0), segments=6), "z", top + 0.0008)
    rivet = Material("rivet", (0.58, 0.58, 0.60), "metal", STEEL)
    return (
        Piece("sleeve", strip, steel),
        Piece("sleeve_etching", below, etched),
        Piece("rivet", shaft + heads - drive, rivet),
    )


def flip_cap_usb(seed: int) -> ObjectModel:
    """The capped stick of a seed. Plug towards -x, hinge across the top; the cap flips up by positive states."""
    rng = np.random.default_rng([seed, 312])
    long, width, thick = np.array([0.0445, 0.0200, 0.0105]) * rng.uniform(0.94, 1.06, 3)
    rubber, accent = _RUBBERS[int(rng.integers(len(_RUBBERS)))]
    coat = textured("rubber", "rubber", _RUBBER, textures.speckle(rng, rubber, 0.04), 0.015)
    ring = Material("accent", accent, "plastic", ABS)
    pivot = (0.0, 0.0, thick / 2 + 0.0004)
    body = Link("heavy usb_body", _grip(long, width, thick, coat, ring, rubber, rng))
    hinge = Hinge("revolute", "link_1", (0, 1, 0), pivot, 0.0, 2.95)
    cap = Link("hinge lid", _cap(width, thick, coat, ring, rng), hinge)
    return ObjectModel("flip_cap_usb", "USB", (cap, body), 0, seed)


def _grip(long: float, width: float, thick: float, coat: Material, ring: Material, rubber: Colour, rng: Rng) -> Pieces:
    whole = rounded_outline(2 * long, width, width * 0.42)
    solid = moulded(whole, thick, "z", 0, 0.0022, 4).trim_by_plane((1, 0, 0), 0)
    outline = rounded_outline(2 * long + 0.0004, width + 0.0004, width * 0.42 + 0.0002)
    band = moulded(outline, thick + 0.0004, "z", 0, 0.0023, 4).trim_by_plane((1, 0, 0), 0.0022)
    band = band.trim_by_plane((-1, 0, 0), -0.0038)
    waves = int(rng.integers(5, 9))
    for k in range(waves):
        x = long * 0.38 + k * 0.0022
        solid -= pair(rod(0.0009, thick * 2, "z", (x, 0, 0), segments=16), "y", width / 2 + 0.0003)
    solid -= rod(0.0016, 0.0050, "y", (0, 0, thick / 2 + 0.0004), segments=24)
    hole = rounded_outline(0.0026, width * 0.42, 0.0012).translate((long - 0.0032, 0))
    solid -= plate(hole, thick * 2, "z")
    for s in (-1, 1):  # the hinge's outer knuckles
        solid += rod(0.0013, 0.0038, "y", (0.0001, s * 0.0047, thick / 2 + 0.0004), 0.0002, 24)
    solid -= rod(0.0008, width, "y", (0.0, 0, thick / 2 + 0.0004), segments=16)
    size = str(rng.choice(["8 GB", "32 GB", "64 GB", "256 GB"]))
    sticker = textures.label([size, "USB 3.1"], (0.95, 0.95, 0.93), textures.shade(rubber, 0.45), 1.7)
    lines = ["FREEART 21", "FLASH DRIVE", f"P/N {int(rng.integers(1000, 9999))}"]
    back = textures.label(lines, rubber, _ink_on(rubber), 1.9, rng, False)
    paper = printed("sticker", sticker)
    print_ = printed("back_print", back)
    glow = tuple(rng.choice([(0.35, 0.75, 0.95), (0.95, 0.35, 0.25), (0.45, 0.9, 0.5)]))
    window = Material("window", glow, "plastic", ABS)
    pane = moulded(rounded_outline(0.0022, width * 0.34, 0.0010), 0.0012, "z", thick / 2, 0.0004)
    return (
        Piece("grip", solid, coat),
        Piece("grip_band", band - rod(0.0016, 0.0050, "y", (0, 0, thick / 2 + 0.0004)), ring),
        Piece("sticker", box((width * 0.92, width * 0.54, 0.0004), (long * 0.55, 0, thick / 2)), paper),
        Piece("back_print", box((long * 0.55, long * 0.29, 0.0004), (long * 0.48, 0, -thick / 2)), print_),
        Piece("window", pane.translate((long * 0.83, 0, 0)), window),
        *_plug(_SILVER, 0.0, rng),
    )


def _cap(width: float, thick: float, coat: Material, ring: Material, rng: Rng) -> Pieces:
    """A cap without a floor but for a lip at its nose: with one, the plug would stop it from turning."""
    nose, gap = -0.0150, 0.0003
    solid = moulded(rounded_outline(-2 * nose, width, width * 0.30), thick, "z", 0, 0.0022, 4)
    solid = solid.trim_by_plane((-1, 0, 0), gap)
    room = 0.0067
    solid -= box((0.0115, 2 * room, thick), (-0.0056, 0, -0.0018))
    solid -= box((0.0130, 2 * room, thick - 0.0032), (-0.0065, 0, -0.0002))
    solid -= pair(rod(0.0016, 0.0044, "y", (0, 0, thick / 2 + 0.0004), segments=24), "y", 0.0047)
    lift = rounded_outline(0.0024, width * 0.5, 0.0010).translate((nose + 0.0001, 0))
    solid += moulded(lift, 0.0030, "z", -thick * 0.08, 0.0008)
    solid += rod(0.0013, 0.0046, "y", (0, 0, thick / 2 + 0.0004), 0.0002, 24)
    solid += box((0.0030, 0.0044, 0.0012), (-0.0016, 0, thick / 2 - 0.0004), 0.0003)
    mark = str(rng.choice(["FA21", "DATA", "KEEP", "DUO"]))
    letters = plate(text_outline(mark, 0.0042, width * 0.6), 0.0008, "z", thick / 2).translate((nose * 0.52, 0, 0))
    pin = Material("hinge_pin", (0.70, 0.70, 0.72), "metal", STEEL)
    return (
        Piece("cap", solid, coat),
        Piece("cap_mark", letters, ring),
        Piece("cap_pin", rod(0.0006, 0.0140, "y", (0, 0, thick / 2 + 0.0004), segments=16), pin),
    )


def folding_usb(seed: int) -> ObjectModel:
    """The folding stick of a seed. Handle along x, flat sides towards -z and +z; the plug folds out over -y."""
    rng = np.random.default_rng([seed, 313])
    colour = _KNIVES[int(rng.integers(len(_KNIVES)))]
    tip, width = 0.0350 * rng.uniform(0.94, 1.06), 0.0190 * rng.uniform(0.96, 1.06)
    steel = textured("scale_steel", "metal", STEEL, textures.brushed_metal(rng, colour), 0.02)
    screw = Material("screws", textures.shade(colour, 0.86), "metal", STEEL)
    handle = Link("heavy usb_body", _handle(tip, width, colour, steel, screw, rng))
    hinge = Hinge("revolute", "link_1", (0, 0, -1), (0, 0, 0), 0.0, np.pi)
    blade = Link("hinge usb_rotation", _blade(tip, width, colour, rng), hinge)
    return ObjectModel("folding_usb", "USB", (blade, handle), 0, seed)


_ROOM = 0.0054
"""Between a folding stick's scales."""


def _handle(tip: float, width: float, colour: Colour, steel: Material, screw: Material, rng: Rng) -> Pieces:
    sheet, half = 0.0017, width / 2
    rear = tip + 0.0125
    outline = CrossSection.batch_hull(
        [CrossSection.circle(half, 48), CrossSection.circle(half * 0.8, 40).translate((rear - half * 0.8, half * 0.2))]
    )
    bite = CrossSection.circle(0.0105, 48).translate((tip * 0.72, -half - 0.0056))  # to nip the plug
    scale = smooth_outline(np.concatenate((outline - bite).to_polygons()), 0.0008)
    cord = CrossSection.circle(0.0019, 24).translate((rear - 0.0042, half * 0.25))
    spine = outline - CrossSection.square((tip + 0.0008, width * 2), True).translate((tip / 2, -half - 0.0012 + 0.0007))
    spine -= CrossSection.square((tip + 0.0012 + half, width * 2)).translate((-half, 0.0068 - 2 * width))
    spine ^= outline.offset(-0.0006)
    holes = [(tip * 0.12, half * 0.70 - 0.0004), (tip * 0.80, half * 0.76), (tip + 0.0030, -half * 0.28)]
    out = _ROOM / 2 + sheet
    scales, discs, texts = [], [], []
    slots = int(rng.integers(3, 6))
    logo = text_outline(str(rng.choice(["POCKET", "FOLIO", "FA-21", "SMITH"])), width * 0.22, tip * 0.5)
    for s in (-1, 1):
        solid = moulded(scale - cord, sheet, "z", s * (out - sheet / 2), 0.0005, 2)
        for k in range(slots):
            slit = rounded_outline(0.0012, width * 0.26, 0.0005, 12).rotate(20)
            slit = slit.translate((tip * 0.30 + (k - slots / 2) * 0.0028, -half * 0.36))
            solid -= plate(slit, 0.0010, "z", s * out)
        letters = (logo if s > 0 else logo.mirror((1, 0))).translate((tip * 0.42, half * 0.22))
        solid -= plate(letters, 0.0006, "z", s * out)
        scales.append(solid)
        for x, y in [*holes, (0.0, 0.0)]:
            size = 0.0030 if x == 0 else 0.0015
            disc = rod(size, 0.0014, "z", (x, y, s * out), 0.0003, 28)
            discs.append(disc - rod(size * 0.5, 0.0010, "z", (x, y, s * (out + 0.0007)), segments=6))
    lines, ground = [f"{2 ** int(rng.integers(4, 8))} GB", "STAINLESS"], textures.brushed_metal(rng, colour)
    etching = textures.label(lines, ground, textures.shade(colour, 0.45, 0.03), 2.0, None, False)
    etched = textured("etching", "metal", STEEL, etching)
    texts = box((tip * 0.26, tip * 0.13, 0.0002), (tip * 0.80, half * 0.20, out))
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    bow = np.stack([0.0058 * np.cos(turn), 0 * turn, 0.0058 * np.sin(turn)], -1)
    ring = tube(bow + np.array([rear - 0.0042 + 0.0055, half * 0.25, 0]), 0.00075, 8, True)
    dark = Material("spine_steel", textures.shade(colour, 0.85), "metal", STEEL)
    wire = Material("key_ring", textures.shade(colour, 1.05), "metal", STEEL)
    return (
        Piece("scale", union(scales), steel),
        Piece("spine", plate(spine - cord, _ROOM, "z"), dark),
        Piece("screws", union(discs), screw),
        Piece("pivot_pin", rod(0.0019, _ROOM, "z", segments=24), screw),
        Piece("etching", texts, etched),
        Piece("key_ring", ring, wire),
    )


def _blade(tip: float, width: float, colour: Colour, rng: Rng) -> Pieces:
    """The part that folds: a carrier round the pivot with the plug at its end."""
    base, half = tip - _PLUG_LONG, 0.0062
    shape = CrossSection.batch_hull(
        [CrossSection.circle(half, 40), CrossSection.square((0.002, 2 * half), True).translate((base - 0.001, 0))]
    )
    solid = moulded(shape - CrossSection.circle(0.0021, 24), 0.0050, "z", 0, 0.0004, 2)
    nick = rounded_outline(0.0060, 0.0011, 0.0005, 12).translate((base * 0.62, -half * 0.62))
    solid -= pair(plate(nick, 0.0010, "z"), "z", 0.0025)
    for k in range(3):
        solid -= box((0.0007, 0.0008, 0.01), (base - 0.003 - 0.0016 * k, -half, 0))
    carrier = Material("carrier", textures.shade(colour, 0.92), "metal", 2700.0)
    plug = [
        Piece(p.name, p.solid.rotate((0, 0, 180)).translate((base, 0, 0)), p.material)
        for p in _plug(textures.shade(colour, 1.06), 0.0, rng)
    ]
    return (Piece("carrier", solid, carrier), *plug)


def _plug(colour: Colour, base: float, rng: Rng) -> Pieces:
    """A type A plug from x = base to base - `_PLUG_LONG`: a steel shell with its tongue and four contacts."""
    steel = textured("plug_steel", "metal", STEEL, textures.brushed_metal(rng, colour), 0.015)
    long, root = _PLUG_LONG, 0.003
    middle = base - (long - root) / 2
    shell = plate(rounded_outline(0.0120, 0.0045, 0.0006, 16), long + root, "x", middle, 0.0002)
    shell -= plate(rounded_outline(0.0114, 0.0039, 0.0004, 16), long, "x", base - long / 2 - 0.0002)
    for s in (-1, 1):
        shell -= box((0.0021, 0.0025, 0.02), (base - long * 0.52, s * 0.0031, 0), 0.0002)
    shell -= box((long, 0.0002, 0.0003), (base - long / 2, 0.0, -0.00225))  # the seam of the bent sheet
    shell -= union(box((0.0034, 0.0002, 0.01), (base - long * 0.25, y, 0)) for y in (-0.0012, 0.0012))
    tongue = box((long - 0.0008, 0.0112, 0.0018), (base - (long - 0.0008) / 2, 0, -0.00103), 0.0002)
    strips = union(
        box((long - 0.0030, 0.0012 if abs(y) > 0.002 else 0.0010, 0.0003), (base - long * 0.5, y, -0.0001))
        for y in (-0.0035, -0.0010, 0.0010, 0.0035)
    )
    blue = bool(rng.integers(2))
    resin = Material("tongue", (0.10, 0.25, 0.70) if blue else (0.12, 0.12, 0.13), "plastic", ABS)
    gold = Material("contacts", (0.86, 0.68, 0.30), "metal", BRASS)
    return (Piece("plug", shell, steel), Piece("plug_tongue", tongue, resin), Piece("plug_contacts", strips, gold))


def _ink_on(colour: Colour) -> Colour:
    """White or near black, whichever shows on `colour`."""
    return (0.96, 0.96, 0.95) if sum(colour) < 1.5 else (0.10, 0.10, 0.12)
