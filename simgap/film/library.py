"""What a camera may do to depth and outlines, as columns over the rows, and nameless rivals in the same table."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21.camera_faults import BOUNDS, CameraFaults, with_values
from freeart21.se3 import Array
from simgap.film.linear import Block
from simgap.film.samples import Rows


@dataclass(frozen=True)
class Effect:
    """One thing that a camera may do, by its parameters' columns."""

    key: str
    """Of this way to do it."""
    name: str
    """As the answer says it; two ways of one thing have one name."""
    parameters: tuple[str, ...]
    """Fields of `CameraFaults`, in the order of the columns."""
    signs: tuple[float, ...]
    """Parameter by coefficient."""


GEOMETRY: tuple[Effect, ...] = (
    Effect("depth_scale", "depth_scale", ("depth_scale",), (1.0,)),
    Effect("depth_offset", "depth_offset", ("depth_offset",), (1.0,)),
    Effect("depth_curve", "depth_curve", ("depth_curve",), (1.0,)),
    Effect("focal_length", "focal_length", ("focal",), (1.0,)),
    Effect("principal_point", "principal_point", ("centre_u", "centre_v"), (1.0, 1.0)),
    Effect("misregistration", "misregistration", ("depth_shift_u", "depth_shift_v", "depth_turn"), (1.0, 1.0, 1.0)),
    Effect(
        "misregistration, poses by depth",
        "misregistration",
        ("depth_shift_u", "depth_shift_v", "depth_turn"),
        (1.0, 1.0, 1.0),
    ),
    Effect("depth_delay", "depth_delay", ("depth_delay",), (1.0,)),
    Effect("depth_delay, poses by depth", "depth_delay", ("depth_delay",), (1.0,)),
)
"""Of the pictures' geometry and timing, and of the depth's size. `poses by depth`: the asset was placed by the depth
picture, and the colour picture is what strays."""
NAMELESS: tuple[str, ...] = ("place in the picture", "distance", "angle of incidence", "lens")
"""Free curves and maps that no name stands for: what they explain and no name does, has no name."""


@dataclass(frozen=True)
class Design:
    """All rows with all columns."""

    blocks: tuple[Block, ...]
    """Depth of inner pixels (metres), mask's outline (pixels), depth's outline (pixels)."""
    columns: dict[str, tuple[int, ...]]
    """Key of an effect, or a nameless rival, to its columns."""


def design_of(rows: Rows, depth_unit: float, exact: bool) -> Design:
    """The rows as blocks. `depth_unit` is the step of the measured depth, metres; `exact` poses leave no doubt."""
    inner, mask, depth = np.isfinite(rows["error"]), np.isfinite(rows["mask_off"]), np.isfinite(rows["depth_off"])
    z, at, slope = rows["z"][inner], rows["at"][inner], rows["slope"][inner]
    edge_at, n, moving = rows["outline"], rows["outward"], rows["moving"]
    middle = float(np.median(z)) if len(z) else 1.0
    size = max(float(np.abs(np.concatenate([at, edge_at])).max(initial=1.0)), 1.0)
    along, along_edge = (slope * at).sum(1), (n * edge_at).sum(1)
    turned, turned_edge = (slope * _turned(at)).sum(1), (n * _turned(edge_at)).sum(1)
    none, none_e = np.zeros(len(z)), np.zeros(len(n))
    later = rows["later"][inner]
    of: dict[str, tuple[Array, Array, Array]] = {
        "depth_scale": _same(z, none_e),
        "depth_offset": _same(np.ones(len(z)), none_e),
        "depth_curve": _same(z * z, none_e),
        "focal_length": (-along, along_edge, along_edge),
        "principal_point": (-slope, n, n),
        "misregistration": (
            np.column_stack([-slope, -turned]),
            np.zeros((len(n), 3)),
            np.column_stack([n, turned_edge]),
        ),
        "misregistration, poses by depth": (
            np.zeros((len(z), 3)),
            -np.column_stack([n, turned_edge]),
            np.zeros((len(n), 3)),
        ),
        "depth_delay": (later, none_e, moving),
        "depth_delay, poses by depth": (none, -moving, none_e),
        "place in the picture": _same(waves(at / size), np.zeros((len(n), 15))),
        "distance": _same(hats(z, 6), np.zeros((len(n), 6))),
        "angle of incidence": _same(hats(rows["cosine"][inner], 6), np.zeros((len(n), 6))),
        "lens": tuple(
            a * b for a, b in zip((-along, along_edge, along_edge), _squares(at, edge_at, size), strict=True)
        ),
    }
    columns: dict[str, tuple[int, ...]] = {}
    count = 0
    stacked: list[list[Array]] = [[], [], []]
    for key, blocks in of.items():
        made = [np.asarray(b, float).reshape(len(b), -1) for b in blocks]
        columns[key] = tuple(range(count, count + made[0].shape[1]))
        count += made[0].shape[1]
        for k in range(3):
            stacked[k].append(made[k])
    full = [np.concatenate(s, 1) for s in stacked]
    floor = depth_floor(middle, depth_unit)
    part = rows["part"][inner]
    one = np.ones((len(z), 1)) if exact else _planes(at / size, part)
    frame_e = rows.of("mask_off")
    return Design(
        (
            Block(rows["error"][inner], full[0], one, rows.of("error")[inner], (floor, floor), 1.0),
            Block(rows["mask_off"][mask], full[1][mask], n[mask], frame_e[mask], (0.15, 0.05), 14.0),
            Block(rows["depth_off"][depth], full[2][depth], n[depth], frame_e[depth], (0.15, 0.05), 14.0),
        ),
        columns,
    )


def _planes(at: Array, part: NDArray[np.int64]) -> Array:
    """(n, 6) an offset and two slopes of each part: what a pose does that is a little off."""
    plane = np.column_stack([np.ones(len(at)), at])
    return np.concatenate([np.where((part == k)[:, None], plane, 0.0) for k in (1, 2)], 1)


def depth_floor(distance: float, depth_unit: float) -> float:
    """Metres: what the comparison of depth cannot tell: half the measured depth's step, or 1 part in 10,000 of the
    distance, a tenth of what the best cameras err by (Tolgyessy 2021: a millimetre at a metre)."""
    return max(0.5 * depth_unit, 1e-4 * distance)


def about(design: Design, effects: tuple[Effect, ...], faults: CameraFaults) -> Design:
    """The design with what `faults`, which the film was simulated with, does to the geometry put back, to first order:
    parameters are then whole ones, and not what is left of them."""
    blocks = []
    for b in design.blocks:
        y = b.y.copy()
        for effect in effects:
            if effect.name.startswith("depth_") and effect.name != "depth_delay":
                continue
            for name, sign, column in zip(effect.parameters, effect.signs, design.columns[effect.key], strict=True):
                y += sign * getattr(faults, name) * b.columns[:, column]
        blocks.append(replace(b, y=y))
    return replace(design, blocks=tuple(blocks))


def faults_of(design: Design, effects: tuple[Effect, ...], chosen: tuple[int, ...], beta: Array) -> CameraFaults:
    """The fitted parameters as camera faults."""
    values: dict[str, float] = {}
    at = {column: value for column, value in zip(chosen, beta, strict=True)}
    for effect in effects:
        for name, sign, column in zip(effect.parameters, effect.signs, design.columns[effect.key], strict=True):
            values[name] = values.get(name, 0.0) + sign * float(at[column])
    return with_values(CameraFaults(), {name: float(np.clip(v, *BOUNDS[name])) for name, v in values.items()})


def hats(x: Array, count: int) -> Array:
    """(n, count) hat functions over x, at its quantiles."""
    if not len(x):
        return np.zeros((0, count))
    knots = np.unique(np.quantile(x, np.linspace(0.01, 0.99, count)))
    out = np.zeros((len(x), count))
    for k in range(len(knots)):
        out[:, k] = np.interp(x, knots, np.eye(len(knots))[k])
    return out


def waves(at: Array) -> Array:
    """(n, 15) products of cosines over the picture, `at` (n, 2) in -1 to 1; all but the constant."""
    x, y = (np.stack([np.cos(np.pi * k * (a + 1) / 2) for k in range(4)], -1) for a in (at[:, 0], at[:, 1]))
    return np.asarray((x[:, :, None] * y[:, None, :]).reshape(len(at), 16)[:, 1:])


def _turned(at: Array) -> Array:
    return np.stack([-at[:, 1], at[:, 0]], -1)


def _same(inner: Array, edge: Array) -> tuple[Array, Array, Array]:
    return inner, edge, edge


def _squares(at: Array, edge: Array, size: float) -> tuple[Array, Array, Array]:
    a, b = (at**2).sum(1) / size**2, (edge**2).sum(1) / size**2
    return a, b, b


def frames_split(n: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Frames to fit, to choose and to confirm with: stretches of frames in turn, as neighbours say the same."""
    stretch = max(1, n // 30)
    turn = (np.arange(n) // stretch) % 3
    return np.flatnonzero(turn == 0), np.flatnonzero(turn == 1), np.flatnonzero(turn == 2)
