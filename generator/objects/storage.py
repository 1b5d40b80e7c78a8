"""A desktop drawer unit of about 26 cm a side: a wooden carcass with two drawers; the upper one moves."""

from __future__ import annotations

import numpy as np

from generator import textures
from generator.model import Hinge, Link, Material, ObjectModel, Piece
from generator.shapes import box, rod, union

_FRONTS = ((0.93, 0.92, 0.88), (0.20, 0.36, 0.46), (0.55, 0.16, 0.16), (0.24, 0.40, 0.28), (0.83, 0.66, 0.28))
_WOODS = (
    ((0.80, 0.62, 0.42), (0.55, 0.36, 0.20)),
    ((0.62, 0.42, 0.26), (0.36, 0.20, 0.11)),
    ((0.88, 0.76, 0.58), (0.70, 0.52, 0.34)),
)
_PINE = 520.0
_BOARD = 0.010
_GAP = 0.0015


def drawer_unit(seed: int) -> ObjectModel:
    """The drawer unit of a seed. The front faces -x; the drawers open by positive states."""
    rng = np.random.default_rng([seed, 202])
    width, depth, height = np.array([0.235, 0.265, 0.245]) * rng.uniform(0.94, 1.06, 3)
    light, dark = _WOODS[int(rng.integers(len(_WOODS)))]
    paint = _FRONTS[int(rng.integers(len(_FRONTS)))]
    carcass = Material("carcass_wood", (1, 1, 1), "wood", _PINE, textures.wood(rng, light, dark), 0.22)
    split = height * rng.uniform(0.50, 0.58)
    root = Link("heavy furniture_body", _carcass(width, depth, height, split, carcass, rng))
    drawers = []
    for k, (bottom, top) in enumerate(((split, height - _BOARD), (_BOARD, split))):
        pieces = _drawer(width - 2 * _BOARD, depth, bottom, top, paint, str(k + 1), rng)
        drawers.append(
            Link("slider drawer", pieces, Hinge("prismatic", "link_2", (-1, 0, 0), (0, 0, 0), 0.0, depth * 0.72))
        )
    return ObjectModel("drawer_unit", "StorageFurniture", (*drawers, root), 0, seed)


def _carcass(
    width: float, depth: float, height: float, split: float, wood: Material, rng: np.random.Generator
) -> tuple[Piece, ...]:
    side = union(box((depth, _BOARD, height), (0, s * (width - _BOARD) / 2, height / 2), 0.0015) for s in (-1, 1))
    inner = width - 2 * _BOARD
    top = box((depth, inner, _BOARD), (0, 0, height - _BOARD / 2), 0.001)
    bottom = box((depth, inner, _BOARD), (0, 0, _BOARD / 2), 0.001)
    shelf = box((depth - 0.012, inner, 0.006), (0.006, 0, split))
    ply = Material(
        "plywood", (1, 1, 1), "wood", 600.0, textures.wood(rng, (0.78, 0.70, 0.55), (0.66, 0.56, 0.42)), 0.15
    )
    back = box((0.005, inner, height - 2 * _BOARD), (depth / 2 - 0.0025, 0, height / 2))
    rubber = Material("feet", (0.08, 0.08, 0.09), "rubber", 1100.0)
    feet = union(
        rod(0.009, 0.006, "z", (sx * (depth / 2 - 0.02), sy * (width / 2 - 0.02), -0.003), 0.001)
        for sx in (-1, 1)
        for sy in (-1, 1)
    )
    sticker = Material(
        "back_label",
        (1, 1, 1),
        "paper",
        900.0,
        textures.label(["FREEART-21", "DRAWER UNIT", "MADE OF CODE"], (0.97, 0.97, 0.95), (0.1, 0.1, 0.12), 1.6, rng),
    )
    note = box((0.0006, inner * 0.50, inner * 0.31), (depth / 2 + 0.0002, 0, height * 0.55))
    badge = Material(
        "top_badge",
        (1, 1, 1),
        "paper",
        900.0,
        textures.label(["TOOLS & PARTS", "A4 / A5"], (0.95, 0.82, 0.25), (0.15, 0.12, 0.05), 2.2, None),
    )
    plate = box((depth * 0.40, depth * 0.18, 0.0006), (-depth * 0.12, width * 0.12, height + 0.0002))
    side_card = Material(
        "side_card",
        (1, 1, 1),
        "paper",
        900.0,
        textures.emblem(rng, np.full((320, 320, 3), 244, np.uint8), (0.16, 0.22, 0.45), "ARCHIVE"),
    )
    cards = union(
        box((height * 0.42, 0.0006, height * 0.42), (depth * 0.05, s * (width / 2 + 0.0002), height * 0.52))
        for s in (-1, 1)
    )
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


def _drawer(
    inner: float,
    depth: float,
    bottom: float,
    top: float,
    paint: textures.Colour,
    number: str,
    rng: np.random.Generator,
) -> tuple[Piece, ...]:
    front_x = -depth / 2
    lacquer = Material("front_lacquer", paint, "plastic", 700.0)
    wood = Material(
        "drawer_wood", (1, 1, 1), "wood", _PINE, textures.wood(rng, (0.86, 0.78, 0.62), (0.74, 0.62, 0.46)), 0.16
    )
    steel = Material("handle_metal", (1, 1, 1), "metal", 7850.0, textures.brushed_metal(rng, (0.75, 0.74, 0.72)), 0.05)
    wide, tall = inner - 2 * _GAP, top - bottom - 0.003 - 2 * _GAP
    middle = (top + bottom + 0.003) / 2 if number == "1" else (top + bottom - 0.003) / 2
    front = box((0.012, wide, tall), (front_x + 0.006, 0, middle), 0.0018)
    long, low = depth - 0.030, middle - tall / 2 + 0.004
    wall_h = tall * 0.72
    sides = union(
        box((long, 0.006, wall_h), (front_x + 0.012 + long / 2, s * (wide / 2 - 0.006), low + wall_h / 2))
        for s in (-1, 1)
    )
    rear = box((0.006, wide - 0.018, wall_h), (front_x + 0.009 + long, 0, low + wall_h / 2))
    floor = box((long, wide - 0.014, 0.004), (front_x + 0.012 + long / 2, 0, low + 0.004))
    felt = Material(
        "felt",
        (1, 1, 1),
        "rubber",
        300.0,
        textures.stripes(((0.20, 0.34, 0.24), (0.24, 0.40, 0.29), (0.86, 0.80, 0.55)), 4),
        0.09,
    )
    lining = box((long - 0.004, wide - 0.020, 0.001), (front_x + 0.012 + long / 2, 0, low + 0.0065))
    divider = box((0.004, wide - 0.020, wall_h * 0.7), (front_x + long * 0.55, 0, low + 0.006 + wall_h * 0.35))
    bar_z, reach = middle + tall * 0.16, 0.022
    bar = rod(0.0045, wide * 0.42, "y", (front_x - reach, 0, bar_z), 0.001)
    posts = union(
        rod(0.0035, reach + 0.004, "x", (front_x - reach / 2 + 0.002, s * wide * 0.16, bar_z)) for s in (-1, 1)
    )
    text = str(rng.choice(["SCREWS M3", "CABLES", "PENCILS", "RECEIPTS", "BATTERIES"]))
    card = Material(
        f"card_{number}",
        (1, 1, 1),
        "paper",
        900.0,
        textures.label([f"{number}  {text}"], (0.97, 0.96, 0.90), (0.12, 0.12, 0.18), 3.4, None),
    )
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
