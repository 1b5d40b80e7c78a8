"""Depth bias, intrinsics, registration and delay of a camera, as columns over the rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from freeart21.camera_faults import CameraFaults
from freeart21.se3 import Array
from simgap.film.choose import Frames, Kind, SetFit
from simgap.film.effects import parameters_of
from simgap.film.linear import Block, LinearFit, density, fit_blocks
from simgap.film.samples import Rows
from simgap.verdict import root_mean_square

BIAS = ("depth_scale", "depth_offset", "depth_curve")
"""Effects of depth bias."""
PICTURE = ("focal_length", "principal_point", "misregistration", "depth_delay")
"""Effects with which a film is simulated anew."""
DISCREPANCIES = ("place in the picture", "distance", "angle of incidence", "lens")
GAPS = ("depth of inner pixels", "outline of the mask", "outline of the depth")
LEAST_DEPTH, LEAST_PX = 5e-4, 0.15
"""An effect is named only if it changes depth by this share of the distance or outlines by this many pixels, RMS: no
camera (Tolgyessy 2021: 1 part in 1,000) and no mask is better."""
MIN_COMBINED_SHARE = 0.3
"""Share of the largest depth bias that several must amount to together. Not measured."""
ROWS = 5000
"""Rows of a kind that a search uses."""


@dataclass(frozen=True)
class Design:
    """All rows with all columns."""

    blocks: tuple[Block, ...]
    columns: dict[str, tuple[int, ...]]
    """Effect, or discrepancy, to its columns."""
    free: tuple[int, ...] = ()
    """Columns of every model."""
    ridge: Array | None = None
    """(K,) prior precision of each parameter about zero."""

    def moves(self, name: str, fit: LinearFit) -> list[Array]:
        """(n,) per block: contribution of an effect of a fit."""
        columns = list(self.columns[name])
        beta = fit.beta[[fit.chosen.index(c) for c in columns]]
        return [b.columns[:, columns] @ beta for b in self.blocks]


def linear_kind(
    name: str,
    design: Design,
    effects: tuple[str, ...],
    discrepancies: tuple[str, ...],
    values_of: Callable[[str, Array], dict[str, float]],
    matters: Callable[[Design, LinearFit, tuple[str, ...]], bool],
    gaps: tuple[str, ...],
) -> Kind:
    """Effects that are columns over the same rows. `values_of` converts an effect's coefficients to parameters."""
    cut: dict[bytes, list[Block]] = {}
    root_squares = np.sqrt(np.mean(np.concatenate([b.columns**2 for b in design.blocks]), 0))

    def blocks_of(frames: Frames) -> list[Block]:
        key = frames.tobytes()
        if key not in cut:
            cut[key] = [b.of(frames) for b in design.blocks]
        return cut[key]

    def fit(names: tuple[str, ...], frames: Frames, rival: str) -> SetFit:
        keys = (*names, rival) if rival else names
        columns = [*design.free, *(c for key in keys for c in design.columns[key])]
        found = fit_blocks(blocks_of(frames), columns, design.ridge)
        values, sizes = dict[str, float](), dict[str, Array]()
        for key in names:
            at = list(design.columns[key])
            beta = found.beta[[found.chosen.index(c) for c in at]]
            values |= values_of(key, beta)
            sizes[key] = beta * root_squares[at]
        return SetFit(values, lambda some: density(blocks_of(some), found, some), matters(design, found, names), sizes)

    return Kind(name, effects, fit, discrepancies, gaps=gaps)


def geometry_kind(design: Design, shut: frozenset[str]) -> Kind:
    """The camera's effects on depth and outlines, without those in `shut`."""
    return linear_kind(
        "depth and outlines",
        replace(design, blocks=tuple(b.thinned(ROWS) for b in design.blocks)),
        tuple(e for e in (*BIAS, *PICTURE) if e not in shut),
        DISCREPANCIES,
        lambda name, beta: dict(zip(parameters_of(name), beta.tolist(), strict=True)),
        _matters,
        GAPS,
    )


def make_design(rows: Rows, depth_unit: float, exact: bool, simulated_with: CameraFaults) -> Design:
    """The rows as blocks: depth of inner pixels (metres), the mask's outline and the depth's outline (pixels).

    Args:
        rows: about the camera `simulated_with`.
        depth_unit: quantisation of the measured depth, metres.
        exact: whether poses are exact; else every frame has a small pose error of each part.
        simulated_with: its geometry and timing are added back to first order, so parameters are total ones.
    """
    inner, mask, depth = np.isfinite(rows["error"]), np.isfinite(rows["mask_off"]), np.isfinite(rows["depth_off"])
    z, at, slope, later = (rows[name][inner] for name in ("z", "at", "slope", "later"))
    edge_at, n, moving = rows["outline"], rows["outward"], rows["moving"]
    size = max(float(np.abs(np.concatenate([at, edge_at])).max(initial=1.0)), 1.0)
    along, along_edge = (slope * at).sum(1), (n * edge_at).sum(1)
    turned, turned_edge = (slope * _rotate_quarter(at)).sum(1), (n * _rotate_quarter(edge_at)).sum(1)
    none = np.zeros(len(n))

    def inner_only(columns: Array) -> tuple[Array, ...]:
        return columns, *[np.zeros((len(n), columns.shape[1]))] * 2

    shifted, shifted_edge = np.column_stack([-slope, -turned]), np.column_stack([n, turned_edge])
    r, r_edge = (at**2).sum(1) / size**2, (edge_at**2).sum(1) / size**2
    of: dict[str, tuple[Array, ...]] = {
        "depth_scale": (z, none, none),
        "depth_offset": (np.ones(len(z)), none, none),
        "depth_curve": (z * z, none, none),
        "focal_length": (-along, along_edge, along_edge),
        "principal_point": (-slope, n, n),
        "misregistration": (shifted, 0 * shifted_edge, shifted_edge),
        "depth_delay": (later, none, moving),
        "place in the picture": inner_only(cosine_products(at / size)),
        "distance": inner_only(hat_functions(z, 6)),
        "angle of incidence": inner_only(hat_functions(rows["cosine"][inner], 6)),
        "lens": (-along * r, along_edge * r_edge, along_edge * r_edge),
    }
    columns, full, held = stack_columns(of, {"place in the picture", "distance", "angle of incidence"})
    floor = depth_floor(float(np.median(z)) if len(z) else 1.0, depth_unit)
    own = np.ones((len(z), 1)) if exact else _planes(at / size, rows["part"][inner])
    edge = rows.of("mask_off")
    outlines = [
        Block(rows[field][on], block[on], n[on], edge[on], (0.15, 0.05), 14.0)
        for field, on, block in (("mask_off", mask, full[1]), ("depth_off", depth, full[2]))
    ]
    blocks = [Block(rows["error"][inner], full[0], own, rows.of("error")[inner], (floor, floor), 1.0), *outlines]
    for name in PICTURE:
        back = np.array([getattr(simulated_with, field) for field in parameters_of(name)])
        blocks = [replace(b, y=b.y + b.columns[:, list(columns[name])] @ back) for b in blocks]
    return Design(tuple(blocks), columns, ridge=held)


def stack_columns(
    of: dict[str, tuple[Array, ...]], held: set[str], deviation: float = 0.01
) -> tuple[dict[str, tuple[int, ...]], list[Array], Array]:
    """Names to column numbers, the columns of each block (n, K), and a ridge (K,) that holds the columns of `held` to
    `deviation`, so that unconstrained ones stay finite."""
    columns, count = dict[str, tuple[int, ...]](), 0
    parts = {key: [np.asarray(b, float).reshape(len(b), -1) for b in blocks] for key, blocks in of.items()}
    for key, blocks in parts.items():
        columns[key] = tuple(range(count, count + blocks[0].shape[1]))
        count += blocks[0].shape[1]
    ridge = np.zeros(count)
    ridge[[c for key in held for c in columns[key]]] = deviation**-2
    return columns, [np.concatenate(block, 1) for block in zip(*parts.values(), strict=True)], ridge


def depth_floor(distance: float, depth_unit: float) -> float:
    """Metres: resolution of the depth comparison: half a quantisation step, or 1e-4 of the distance, a tenth of the
    error of the best cameras (Tolgyessy 2021: a millimetre at a metre)."""
    return max(0.5 * depth_unit, 1e-4 * distance)


def hat_functions(x: Array, knots: int | Array) -> Array:
    """(n, knots) hat functions over x (n,), at its quantiles or at given knots."""
    if isinstance(knots, int):
        knots = np.unique(np.quantile(x, np.linspace(0.01, 0.99, knots))) if len(x) else np.arange(float(knots))
    return np.stack([np.interp(x, knots, one) for one in np.eye(len(knots))], -1)


def cosine_products(at: Array) -> Array:
    """(n, 15) products of cosines over the picture, `at` (n, 2) in -1 to 1; without the constant."""
    x, y = (np.stack([np.cos(np.pi * k * (a + 1) / 2) for k in range(4)], -1) for a in (at[:, 0], at[:, 1]))
    return np.asarray((x[:, :, None] * y[:, None, :]).reshape(len(at), 16)[:, 1:])


def _rotate_quarter(at: Array) -> Array:
    return np.stack([-at[:, 1], at[:, 0]], -1)


def _planes(at: Array, part: NDArray[np.int64]) -> Array:
    """(n, 6) an offset and two slopes of each part: a small pose error."""
    plane = np.column_stack([np.ones(len(at)), at])
    return np.concatenate([np.where((part == k)[:, None], plane, 0.0) for k in (1, 2)], 1)


def _matters(design: Design, fit: LinearFit, names: tuple[str, ...]) -> bool:
    """Whether every effect moves depth or outlines enough, and depth biases do not cancel each other."""
    z = design.blocks[0].columns[:, design.columns["depth_scale"][0]]
    distance = float(np.median(z)) if len(z) else 1.0
    moves = {name: design.moves(name, fit) for name in names}
    for move in moves.values():
        depth, *outlines = (root_mean_square(m) for m in move)
        if depth < LEAST_DEPTH * distance and max(outlines) < LEAST_PX:
            return False
    bias = [moves[name][0] for name in names if name in BIAS]
    return len(bias) < 2 or root_mean_square(np.sum(bias, 0)) >= MIN_COMBINED_SHARE * max(
        root_mean_square(m) for m in bias
    )
