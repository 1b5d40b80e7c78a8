"""Scissors: two blades, near mirror images, that lie on each other and turn about one screw.

All are drawn flat, the points up and the front towards the viewer, and stood up last. A half is drawn as the front
one: its handle on the left, its blade in the layer just above z = 0 with the cutting edge on the left. The rear half
is drawn likewise and turned half a turn about y, which is why the two are nearly, and not quite, mirror images.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.typing import ArrayLike, NDArray

from generator import textures
from generator.model import ABS, STEEL, Hinge, Link, Material, ObjectModel, Piece, Rng, printed, textured
from generator.shapes import box, lathe, moulded, plate, polygon, rod, softened, stood, stroke, text_outline, union
from generator.textures import Colour

_TPE = 950.0
_GAP = 0.00008
"""Half the slit between the blades."""

_OFFICE = (
    ((0.10, 0.10, 0.11), (0.78, 0.10, 0.10)),
    ((0.07, 0.18, 0.42), (0.55, 0.60, 0.66)),
    ((0.86, 0.34, 0.05), (0.16, 0.16, 0.17)),
    ((0.13, 0.34, 0.24), (0.72, 0.76, 0.40)),
    ((0.36, 0.36, 0.39), (0.10, 0.55, 0.62)),
)
"""Colours of the hard handle and of its soft lining."""

_SHEARS = ((0.66, 0.67, 0.69), (0.17, 0.17, 0.18), (0.52, 0.45, 0.36), (0.40, 0.42, 0.46), (0.70, 0.62, 0.45))
"""Colours of satin nickel, black oxide, bronze, gunmetal and brass plate."""

_CRAFT = (
    ((0.95, 0.76, 0.10), (0.10, 0.50, 0.78)),
    ((0.90, 0.22, 0.35), (0.98, 0.80, 0.30)),
    ((0.30, 0.70, 0.32), (0.95, 0.50, 0.12)),
    ((0.58, 0.32, 0.72), (0.30, 0.78, 0.76)),
    ((0.10, 0.62, 0.86), (0.96, 0.40, 0.62)),
)
"""Colours of the two handles."""


def office_scissors(seed: int) -> ObjectModel:
    """Office scissors of about 21 cm: steel blades, plastic handles with a soft lining, one loop larger."""
    rng = np.random.default_rng([seed, 811])
    reach, size = 0.104 * rng.uniform(0.94, 1.06), rng.uniform(0.95, 1.05)
    hard, soft = _OFFICE[int(rng.integers(len(_OFFICE)))]
    steel = _brushed("blade_steel", (0.70, 0.71, 0.73), rng)
    ground = _brushed("ground_steel", (0.82, 0.83, 0.85), rng)
    handle = textured("handle_plastic", "plastic", ABS, textures.speckle(rng, hard, 0.10), 0.015)
    lining = Material("soft_lining", soft, "rubber", _TPE)
    thumb = _loop((-0.0262, -0.074), (0.0170, 0.0235), -6, size)
    fingers = _loop((-0.0270, -0.074), (0.0185, 0.0330), 8, size)
    halves = []
    for side, loop in (("front", thumb), ("rear", fingers)):
        blade = _office_blade(reach)
        shank = stroke(size * np.array([(-0.0065, -0.0165), (-0.0095, -0.030), (-0.0165, -0.048)]), 0.0065 * size)
        grip = _handle_outline(shank, loop, 0.0052, 0.012)
        ring = loop.offset(-0.0049) - loop.offset(-0.0072)
        lines = [
            [(-0.0128 - 0.0018 * k, y), (-0.0052 - 0.0018 * k, y)] for k, y in enumerate((-0.030, -0.0335, -0.037))
        ]
        ridges = union(moulded(stroke(size * np.array(line), 0.0006), 0.0110, "z") for line in lines)
        word = text_outline(str(rng.choice(["FA21", "KORA", "SNIP"])), 0.0034)
        logo = plate(word, 0.0020, "z", 0.0045).rotate((0, 0, 75))
        body, edge = _ground(blade, (-0.0068, 0.013), (-0.0006, reach), 0.0034, 0.0017)
        halves.append(
            [
                Piece(f"{side}_blade", body, steel),
                Piece(f"{side}_edge", edge, ground),
                Piece(f"{side}_handle", moulded(grip, 0.0105, "z", 0, 0.0024, 3), handle),
                Piece(f"{side}_lining", moulded(ring, 0.0085, "z", 0, 0.0010, 2), lining),
                Piece(f"{side}_ridges", ridges, lining),
                Piece(f"{side}_brand", logo.translate((-0.0122 * size, -0.0448 * size, 0)), lining),
            ]
        )
    print_ = _engraving(["STAINLESS", f"FA-21  {round(200 * reach / 0.104)} mm"], (0.70, 0.71, 0.73), rng)
    halves[0].append(Piece("front_print", _plaque((0.0052, 0.033), (0.0028, 0.040), 0.0017), print_))
    stamp = _engraving([str(rng.choice(["SOLINGEN", "SHEFFIELD", "SEKI"]))], (0.70, 0.71, 0.73), rng, 6.0)
    halves[1].append(Piece("rear_print", _plaque((0.0044, 0.026), (0.0030, 0.036), 0.0017), stamp))
    screw = _screw(0.0050, 0.0023, 0.0017, rng.uniform(0, 180), ground)
    rivet = Piece("rivet", _nut(0.0040, 0.0008, 0.0017), steel)
    return _pair("office_scissors", seed, halves, [*screw, rivet], 0.0024, rng.uniform(0.95, 1.15))


def tailor_shears(seed: int) -> ObjectModel:
    """Tailor's shears of about 27 cm, all of one metal: bent handles, a long bow for the fingers, a small one."""
    rng = np.random.default_rng([seed, 822])
    reach, size = 0.152 * rng.uniform(0.94, 1.06), rng.uniform(0.95, 1.05)
    colour = _SHEARS[int(rng.integers(len(_SHEARS)))]
    steel = _brushed("blade_metal", colour, rng)
    ground = _brushed("ground_metal", textures.shade(colour, 1.06, 0.02), rng)
    cast = textured("cast_metal", "metal", STEEL, textures.speckle(rng, colour, 0.04), 0.02)
    relief = Material("relief", textures.shade(colour, 0.85), "metal", STEEL)
    bend = rng.uniform(17, 23)
    fingers = _loop((-0.0240, -0.086), (0.0190, 0.0390), 7, size)
    thumb = _loop((-0.0225, -0.064), (0.0180, 0.0235), 4, size)
    halves = []
    for side, loop, wall, lean in (("front", fingers, 0.0062, bend), ("rear", thumb, 0.0060, -bend)):
        edge_at = (-0.0105, 0.022), (-0.0009, reach)
        outline = _outline([*edge_at, (0.0009, reach), (0.0052, reach * 0.86), (0.0105, reach * 0.5), (0.0140, 0.012)])
        outline += stroke([(0.0015, 0.010), (0.0, 0.0), (-0.004, -0.010)], [0.0125, 0.0125, 0.0090])
        blade = _raised(softened(_filled(outline, 0.012), 0.0006), 0.0038, 0.0004)
        body, edge = _ground(blade, *edge_at, 0.0062, 0.0038)
        shank = stroke(
            size * np.array([(0, 0), (-0.0060, -0.012), (-0.0100, -0.030), (-0.0135, -0.050)]),
            np.array([0.0118, 0.0092, 0.0068, 0.0062]) * size,
        )
        under = _left_of(0.0005) + CrossSection.circle(0.0150 * size)  # round the screw a half may pass the middle line
        bow = (shank ^ under) + _handle_outline(shank, loop, wall, 0.016)
        bow = softened(bow + loop, 0.0036, 40) - loop.offset(-wall, circular_segments=64)
        handle = _swelling(moulded(bow, 0.010, "z", 0, 0.0028, 4), 0.0034, 0.0105)
        pieces = [
            Piece(f"{side}_blade", body, steel),
            Piece(f"{side}_edge", edge, ground),
            Piece(f"{side}_bow", handle.rotate((0, 0, lean)), cast),
        ]
        halves.append(pieces)
    mark = str(rng.choice(["SHEFFIELD", "SOLINGEN", "TAILOR 11"]))
    name = _raised(text_outline(mark, 0.0052), 0.0003, 0).rotate((0, 0, 90)).translate((0.0015, reach * 0.36, 0.0037))
    halves[0].append(Piece("front_name", name, relief))
    number = _raised(text_outline(f"No {int(rng.integers(8, 13))}", 0.0060), 0.0003, 0).rotate((0, 0, 90))
    halves[1].append(Piece("rear_number", number.translate((0.0015, reach * 0.30, 0.0037)), relief))
    crown = _engraving(["FREEART", f"21  {int(rng.integers(100, 999))}"], colour, rng)
    halves[1].append(Piece("rear_stamp", _plaque((0.0060, 0.034), (0.0052, reach * 0.46), 0.0038), crown))
    knurled = textured("knurled_metal", "metal", STEEL, _knurl(colour), 0.010)
    screw = _screw(0.0086, 0.0034, 0.0046, rng.uniform(0, 180), steel)
    nut = Piece("nut", _nut(0.0076, 0.0036, 0.0046), knurled)
    return _pair("tailor_shears", seed, halves, [*screw, nut], 0.0036, rng.uniform(0.88, 1.05))


def craft_scissors(seed: int) -> ObjectModel:
    """Children's scissors of about 13 cm: short, round-nosed blades with a ruler, two bright handles."""
    rng = np.random.default_rng([seed, 833])
    reach, size = 0.060 * rng.uniform(0.94, 1.06), rng.uniform(0.95, 1.06)
    colours = _CRAFT[int(rng.integers(len(_CRAFT)))]
    steel = _brushed("blade_steel", (0.74, 0.75, 0.77), rng)
    ground = _brushed("ground_steel", (0.84, 0.85, 0.87), rng)
    halves = []
    for k, side in enumerate(("front", "rear")):
        paint = Material(f"{side}_plastic", colours[k], "plastic", ABS)
        soft = Material(f"{side}_lining", colours[1 - k], "rubber", _TPE)
        loop = _loop((-0.0208, -0.048 - 0.002 * k), (0.0158, 0.0170 + 0.0030 * k), -4, size)
        edge_at = (-0.0060, 0.010), (-0.0046, reach - 0.004)
        nose = CrossSection.circle(0.0050, 40).translate((0.0006, reach - 0.0050))
        waist = CrossSection.circle(0.0070, 40).translate((0.0008, 0.006))
        outline = CrossSection.batch_hull([nose, waist, CrossSection.circle(0.0068, 40)])
        blade = _raised(outline, 0.0015, 0.00025)
        body, edge = _ground(blade, *edge_at, 0.0024, 0.0015)
        shank = stroke(
            size * np.array([(-0.0058, -0.0136), (-0.0082, -0.0210), (-0.0130, -0.0330)]), [0.0058, 0.0064, 0.0068]
        )
        grip = _handle_outline(shank, loop, 0.0050, 0.008)
        ring = loop.offset(-0.0047) - loop.offset(-0.0066)
        tang = stroke([(0, 0), (-0.0060, -0.014)], [0.0060, 0.0040])
        dots = union(
            lathe([(0, -0.0006), (0.0019, -0.0006), (0.0016, 0.0003), (0, 0.0006)], "z", (x * size, y * size, 0.0043))
            for x, y in ((-0.0080, -0.0185), (-0.0100, -0.0245), (-0.0120, -0.0305))
        )
        pieces = [
            Piece(f"{side}_blade", body + _raised(tang, 0.0015, 0.00025), steel),
            Piece(f"{side}_edge", edge, ground),
            Piece(f"{side}_handle", moulded(grip, 0.0088, "z", 0, 0.0023, 3), paint),
            Piece(f"{side}_lining", moulded(ring, 0.0070, "z", 0, 0.0008, 2), soft),
            Piece(f"{side}_dots", dots, soft),
        ]
        halves.append(pieces)
    scale = textured("ruler_print", "metal", STEEL, np.rot90(_ruler(5, 0.0068 / 0.042)).copy())
    halves[0].append(Piece("front_ruler", _plaque((0.0068, 0.042), (0.0019, 0.0310), 0.0015), scale))
    card = textures.label([str(rng.choice(["KIDS", "ANNA", "LEO", "SCHOOL"]))], (0.98, 0.98, 0.96), colours[0], 3.6)
    name = printed("name_sticker", np.rot90(card).copy())
    halves[1].append(Piece("rear_sticker", _plaque((0.0070, 0.026), (0.0014, 0.028), 0.0015), name))
    screw = _screw(0.0046, 0.0022, 0.0015, rng.uniform(0, 180), ground)
    rivet = Piece("rivet", _nut(0.0038, 0.0008, 0.0015), steel)
    return _pair("craft_scissors", seed, halves, [*screw, rivet], 0.0022, rng.uniform(0.90, 1.10))


def _pair(
    name: str, seed: int, halves: list[list[Piece]], fastening: list[Piece], shaft: float, upper: float
) -> ObjectModel:
    """The scissors of a front and a rear half: the front one turns about the screw, which the rear one holds."""
    hole = rod(shaft + 0.0001, 0.03, "z", segments=32)
    front = [replace(piece, solid=stood(piece.solid - hole)) for piece in halves[0]]
    rear = [replace(piece, solid=stood(piece.solid.rotate((0, 180, 0)) - hole)) for piece in halves[1]]
    rear += [replace(piece, solid=stood(piece.solid)) for piece in fastening]
    moving = Link("hinge blade", tuple(front), Hinge("revolute", "link_1", (1, 0, 0), (0, 0, 0), 0.0, upper))
    root = Link("heavy blade", tuple(rear))
    return ObjectModel(name, "Scissors", (moving, root), 0, seed)


def _office_blade(reach: float) -> Manifold:
    """A slender pointed blade with its tang, that the handle hides."""
    spine = [(0.0007, reach), (0.0030, reach * 0.93), (0.0062, reach * 0.74), (0.0086, reach * 0.42), (0.0090, 0.010)]
    outline = _outline([(-0.0068, 0.013), (-0.0006, reach), *spine])
    outline += stroke([(0.0008, 0.006), (0, 0), (-0.006, -0.014), (-0.011, -0.034)], [0.0084, 0.0082, 0.0055, 0.0040])
    return _raised(softened(_filled(outline, 0.010), 0.0006), 0.0017, 0.0002)


def _outline(points: ArrayLike) -> CrossSection:
    """The outline through `points` from the heel of the edge over the point down the spine."""
    return polygon(np.asarray(points, float)[::-1])


def _filled(outline: CrossSection, radius: float) -> CrossSection:
    """The outline with its inward corners filled by rounds."""
    return outline.offset(radius, circular_segments=64).offset(-radius, circular_segments=64)


def _raised(outline: CrossSection, thickness: float, bevel: float) -> Manifold:
    """The outline as a plate in the front layer, just above the slit between the blades."""
    solid = moulded(outline, thickness, "z", 0, bevel, 1) if bevel > 0 else plate(outline, thickness, "z")
    return solid.translate((0, 0, _GAP + thickness / 2))


def _loop(centre: tuple[float, float], half: tuple[float, float], tilt: float, size: float) -> CrossSection:
    """An egg about `centre`, its blunt end down, leaning by `tilt` degrees."""
    t = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    egg = polygon(np.c_[half[0] * np.cos(t) * (1 - 0.13 * np.sin(t)), half[1] * np.sin(t)] * size)
    return egg.rotate(tilt).translate((centre[0] * size, centre[1] * size))


def _handle_outline(shank: CrossSection, loop: CrossSection, wall: float, hollow: float) -> CrossSection:
    """Shank and loop as one: the corners between them filled by rounds of `hollow`, a hole within the `wall`."""
    joined = _filled((shank + loop) ^ _left_of(0.0004), hollow)
    return softened(joined, 0.0036, 40) - loop.offset(-wall, circular_segments=64)


def _left_of(gap: float) -> CrossSection:
    """All that lies left of the middle line by at least `gap`: handles meet there, and do not overlap."""
    return CrossSection.square((0.4, 0.8)).translate((-0.4 - gap, -0.4))


def _ground(
    blade: Manifold, heel: tuple[float, float], tip: tuple[float, float], width: float, thickness: float
) -> tuple[Manifold, Manifold]:
    """A blade ground to an edge from `heel` to `tip`: what is left of its flat, and the strip of `width` at the edge.

    The strip falls from the full thickness to a fifth of a millimetre at the edge.
    """
    start, end = np.array(heel), np.array(tip)
    along = (end - start) / np.linalg.norm(end - start)
    inwards = np.array([along[1], -along[0]])
    fine = 0.0002
    slope = (thickness - fine) / width

    def prism(section: ArrayLike) -> Manifold:  # (distance from the edge, height) drawn along the edge
        rings = [
            [(*(start + t * along + s * inwards), _GAP + z) for s, z in np.asarray(section, float)]
            for t in (0.0, float(np.linalg.norm(end - start)) + 0.03)
        ]
        return Manifold.hull_points(np.concatenate(rings))

    far = -0.02
    waste = prism([(far, fine + far * slope), (1.5 * width, fine + 1.5 * width * slope), (far, 0.05)])
    strip = prism([(far, -0.01), (width, -0.01), (width, 0.02), (far, 0.02)])
    edge, body = (blade - waste).split(strip)
    return body, edge


def _swelling(bow: Manifold, flat: float, full: float) -> Manifold:
    """A bow of 10 mm thickness made a casting: `flat` and in the front layer at the screw, `full` about z = 0 below."""

    def reshape(points: NDArray[np.float64]) -> NDArray[np.float64]:
        share = np.clip((-points[:, 1] - 0.015) / 0.035, 0, 1)
        share = share**2 * (3 - 2 * share)
        low = (1 - share) * (_GAP + 0.0002) - share * full / 2
        high = (1 - share) * (_GAP + flat + 0.0012) + share * full / 2
        return np.asarray(np.c_[points[:, :2], low + (points[:, 2] / 0.010 + 0.5) * (high - low)])

    return bow.refine_to_length(0.006).warp_batch(reshape)


def _screw(radius: float, shaft: float, thickness: float, turn: float, metal: Material) -> list[Piece]:
    """A slotted screw through both blades, each of `thickness`, its domed head in front."""
    top = _GAP + thickness + 0.00006
    rim = [(0, 0), (radius * 0.94, 0), (radius, radius * 0.08), (radius * 0.9, radius * 0.24)]
    head = lathe([*rim, (radius * 0.5, radius * 0.36), (0, radius * 0.38)], "z", (0, 0, top), 40)
    slot = box((2.4 * radius, radius * 0.26, radius * 0.5), (0, 0, top + radius * 0.40)).rotate((0, 0, turn))
    floor = box((1.8 * radius, radius * 0.26, radius * 0.06), (0, 0, top + radius * 0.15)).rotate((0, 0, turn))
    dark = Material("slot", textures.shade(_mean(metal), 0.4), "metal", STEEL)
    return [
        Piece("screw", union((head - slot, rod(shaft, 2 * top, "z", segments=32))), metal),
        Piece("screw_slot", floor, dark),
    ]


def _nut(radius: float, height: float, thickness: float) -> Manifold:
    """The nut, or the rivet's end, behind the rear blade of `thickness`."""
    profile = [(0, 0), (radius, 0), (radius * 0.95, height * 0.7), (radius * 0.75, height), (0, height)]
    nut = lathe(profile, "z", (0, 0, 0))
    return nut.rotate((180, 0, 0)).translate((0, 0, 0.00005 - _GAP - thickness))


def _plaque(size: tuple[float, float], at: tuple[float, float], thickness: float) -> Manifold:
    """A print on the outer face of a blade."""
    return box((*size, 0.0002), (*at, _GAP + thickness + 0.00002))


def _mean(material: Material) -> Colour:
    """The colour that a material has on the whole."""
    if material.texture is None:
        return material.colour
    r, g, b = material.texture.reshape(-1, 3).mean(0) / 255
    return float(r), float(g), float(b)


def _brushed(name: str, colour: Colour, rng: Rng) -> Material:
    return textured(name, "metal", STEEL, textures.brushed_metal(rng, colour), 0.05)


def _engraving(lines: list[str], colour: Colour, rng: Rng, aspect: float = 6.3) -> Material:
    """Words etched into the metal, to be read with the points to the left."""
    metal = np.rot90(textures.brushed_metal(rng, colour))
    words = textures.label(lines, metal, textures.shade(colour, 0.45), aspect, None, False, 128)
    return textured("_".join(lines).lower().replace(" ", ""), "metal", STEEL, np.rot90(words).copy())


def _knurl(colour: Colour) -> NDArray[np.uint8]:
    """Shallow crossing grooves, near the metal's own colour."""
    deep = textures.knurl(colour, 6).astype(float)
    return np.rint(0.65 * 255 * np.array(colour) + 0.35 * deep).astype(np.uint8)


def _ruler(centimetres: int, aspect: float) -> NDArray[np.uint8]:
    """A centimetre scale, `aspect` times as high as long, its zero at the left."""
    long = 800
    picture = np.full((round(long * aspect), long, 3), (222, 224, 227), np.uint8)
    step = (long - 40) / (10 * centimetres)
    for k in range(10 * centimetres + 1):
        x = round(20 + k * step)
        tall = 0.50 if k % 10 == 0 else 0.38 if k % 5 == 0 else 0.24
        cv2.line(picture, (x, 0), (x, round(tall * len(picture))), (20, 24, 60), 3)
        if k % 10 == 0 and 0 < k < 10 * centimetres:
            at = (x - 14, len(picture) - 10)
            cv2.putText(picture, str(k // 10), at, cv2.FONT_HERSHEY_DUPLEX, 1.3, (20, 24, 60), 3)
    return picture
