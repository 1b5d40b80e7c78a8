"""What the camera does to depth and outlines: which set of effects, by frames that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.film.choose import LEAST_SHARE, Tried, smallest
from simgap.film.library import GEOMETRY, NAMELESS, Design, Effect
from simgap.film.linear import Block, LinearFit, density, fitted

MOST = 3
"""Effects of a set up to which several are widened; more are added one by one while they help."""
LEAST_DEPTH, LEAST_PX = 5e-4, 0.15
"""An effect is not named that moves depth by less than this share of the distance and outlines by less than this many
pixels, both as root mean squares: no camera is so good (Tolgyessy 2021: 1 part in 1,000), and no mask."""
TOGETHER = 0.3
"""Share of the largest of them that several errors of the depth's size must come to together. Not measured."""
BEAM = 5
"""Sets of each size that are widened: greedy search picks the best single effect and cannot reach a pair without it."""
ROWS = 5000
"""Of a kind, that a search reads."""


@dataclass(frozen=True)
class Geometry:
    """What the search came to."""

    chosen: tuple[Effect, ...]
    rivals: tuple[tuple[str, ...], ...]
    """Sets of keys that the frames cannot tell from the chosen one, itself first."""
    fit: LinearFit
    tried: tuple[Tried, ...]
    """Best first."""
    null: Tried
    null_fit: LinearFit
    beside: dict[str, tuple[Tried, Tried, LinearFit]]
    """Nameless rival to itself, itself beside the chosen set, and that fit."""


def by_key(key: str) -> Effect:
    """The effect of the library."""
    return next(effect for effect in GEOMETRY if effect.key == key)


def thinned(blocks: Sequence[Block], most: int) -> tuple[Block, ...]:
    """At most about `most` rows of each kind, evenly drawn."""
    out = []
    for b in blocks:
        step = max(1, len(b.y) // most)
        out.append(Block(b.y[::step], b.columns[::step], b.own[::step], b.frame[::step], b.least, b.span))
    return tuple(out)


def search(
    design: Design,
    fit_on: NDArray[np.int64],
    choose_on: NDArray[np.int64],
    shut: frozenset[str] = frozenset(),
    most: int = MOST,
) -> Geometry:
    """The smallest set of effects that the frames `choose_on` (indices) ask for.

    Names and keys in `shut` are not tried; the best sets of each size are widened, up to `most` effects, and then the
    best alone.
    """
    blocks = thinned(design.blocks, ROWS)
    fitting = [b.of(fit_on) for b in blocks]
    choosing = [b.of(choose_on) for b in blocks]
    fits: dict[tuple[str, ...], LinearFit] = {}
    tried: list[Tried] = []

    def attempt(keys: tuple[str, ...], nameless: bool = False) -> Tried | None:
        columns = [c for key in keys for c in design.columns[key]]
        ridge = _ridge(design, keys)
        fits[keys] = fit = fitted(fitting, columns, ridge)
        if not nameless and not all(_matters(design, blocks, key, fit) for key in keys):
            return None
        if not nameless and _cancel(design, blocks, keys, fit):
            return None
        found = Tried(keys, len(columns), density(choosing, fit, choose_on), nameless)
        tried.append(found)
        return found

    null = attempt(())
    assert null is not None
    effects = [e for e in GEOMETRY if not {e.name, e.key} & shut]
    if _at_the_floor(fits[()], blocks):
        return Geometry((), ((),), fits[()], tuple(tried), null, fits[()], {})
    beam: list[tuple[str, ...]] = [()]
    for _ in range(most):
        wider = {
            tuple(e.key for e in effects if e.key in (*keys, more.key))
            for keys in beam
            for more in effects
            if more.name not in {by_key(k).name for k in keys}
        }
        level = [(attempt(keys), keys) for keys in sorted(wider)]
        beam = [keys for found, keys in sorted(level, key=lambda f: -(f[0].mean if f[0] else -np.inf))[:BEAM]]
    first, alike = smallest(tried, LEAST_SHARE)
    while len(first.names) >= most:
        more = [e for e in effects if e.name not in {by_key(k).name for k in first.names}]
        added = [attempt((*first.names, e.key)) for e in more]
        again, alike_again = smallest(tried, LEAST_SHARE)
        if again is first or not any(added):
            break
        first, alike = again, alike_again
    beside = {}
    for key in NAMELESS:
        alone = attempt((key,), nameless=True)
        if first.names:
            both = attempt((*first.names, key), nameless=True)
            assert alone is not None and both is not None
            beside[key] = alone, both, fits[(*first.names, key)]
    ordered = tuple(sorted(tried, key=lambda t: -t.mean))
    own = {tuple(sorted(by_key(k).name for k in first.names))}
    rivals = [first.names]
    for t in alike:
        names = tuple(sorted(by_key(k).name for k in t.names))
        if names not in own:
            own.add(names)
            rivals.append(t.names)
    return Geometry(
        tuple(by_key(k) for k in first.names), tuple(rivals), fits[first.names], ordered, null, fits[()], beside
    )


def _at_the_floor(fit: LinearFit, blocks: Sequence[Block]) -> bool:
    """Whether the film as it is lacks nothing that the comparison could tell."""
    return all(
        s <= 1.01 * b.least[0] and t <= 1.01 * b.least[1] for s, t, b in zip(fit.sigma, fit.tau, blocks, strict=True)
    )


def _ridge(design: Design, keys: tuple[str, ...]) -> np.ndarray | None:
    """Nameless curves are held to a hundredth of a metre, so that what no row tells stays finite."""
    free = [c for key in keys if key in NAMELESS and key != "lens" for c in design.columns[key]]
    if not free:
        return None
    ridge = np.zeros(design.blocks[0].columns.shape[1])
    ridge[free] = 1 / 0.01**2
    return ridge


def moved(design: Design, blocks: Sequence[Block], key: str, fit: LinearFit) -> tuple[float, float]:
    """How far an effect of a fit moves depth, as a share of the distance, and outlines, pixels: root mean squares."""
    at = {column: value for column, value in zip(fit.chosen, fit.beta, strict=True)}
    columns = list(design.columns[key])
    beta = np.array([at[c] for c in columns])
    sizes = []
    for b in blocks:
        sizes.append(float(np.sqrt(np.mean((b.columns[:, columns] @ beta) ** 2))) if len(b.y) else 0.0)
    z = blocks[0].columns[:, design.columns["depth_scale"][0]]
    return sizes[0] / max(float(np.median(z)) if len(z) else 1.0, 1e-9), max(sizes[1], sizes[2])


def _cancel(design: Design, blocks: Sequence[Block], keys: tuple[str, ...], fit: LinearFit) -> bool:
    """Whether several errors of the depth's size mostly undo each other: together they are then no more than a curve
    through something else."""
    bias = [k for k in keys if k in ("depth_scale", "depth_offset", "depth_curve")]
    if len(bias) < 2:
        return False
    at = {column: value for column, value in zip(fit.chosen, fit.beta, strict=True)}
    columns = [c for k in bias for c in design.columns[k]]
    parts = blocks[0].columns[:, columns] * np.array([at[c] for c in columns])
    alone = float(np.sqrt((parts**2).mean(0)).max())
    return float(np.sqrt((parts.sum(1) ** 2).mean())) < TOGETHER * alone


def _matters(design: Design, blocks: Sequence[Block], key: str, fit: LinearFit) -> bool:
    depth, px = moved(design, blocks, key, fit)
    return depth >= LEAST_DEPTH or px >= LEAST_PX
