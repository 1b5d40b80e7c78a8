"""Model selection for one kind of effects: forward selection by beam search, judged by frames that were not fitted.

Scores and the one-standard-error rule are those of `simgap.select.predictive`, with stretches of frames in place of
stretches of runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from freeart21.effects.base import Effect
from freeart21.se3 import Array
from simgap.film.effects import effect_of
from simgap.models.localise import sign_flip_test
from simgap.select.predictive import Score, score_difference, select_smallest

Frames = NDArray[np.int64]
"""(n,) indices of frames, ascending."""
BEAM = 5
"""Sets of each size that are extended; greedy search takes the best single effect and may miss a pair."""
LEAST_SHARE = 0.01
"""Share of the best set's gain that a larger set must add: columns are of first order, so curvature leaves less. Not
measured."""
MAX_SIZE_CHANGE = 0.5
"""Relative change of an effect's size with a discrepancy that explains more. Not measured."""
DOMINATION_RATIO = 2.0
"""Ratio of a discrepancy's gain to the set's above which the set does not explain it."""
GROUPS = 8
"""Jackknife groups of frames for standard errors."""


@dataclass(frozen=True)
class SetFit:
    """A fitted set of effects."""

    values: dict[str, float]
    """By parameter."""
    judge: Callable[[Frames], Array]
    """Frames to the log density of each."""
    matters: bool = True
    """Whether each of its effects is large enough to be named."""
    sizes: dict[str, Array] = field(default_factory=dict)
    """Effect to its parameters, scaled by what they move, where it may be compared with and without a discrepancy."""


@dataclass(frozen=True)
class Kind:
    """Effects that are judged by the same rows."""

    name: str
    effects: tuple[str, ...]
    fit: Callable[[tuple[str, ...], Frames, str], SetFit | None]
    """Effects, frames and a discrepancy ('' for none) to the fit; None for an invalid set."""
    discrepancies: tuple[str, ...] = ()
    """Free curves and maps without a name."""
    spare: float = LEAST_SHARE
    gaps: tuple[str, ...] = ()
    """The gaps that its effects close (`proof`)."""


@dataclass(frozen=True)
class Chosen:
    """Result of the selection for one kind."""

    kind: Kind
    names: tuple[str, ...]
    """The smallest set within one standard error of the best; none for the film as it is."""
    rivals: tuple[tuple[str, ...], ...]
    """All sets of this size that are, itself first."""
    values: dict[str, float]
    errors: dict[str, float]
    """Standard errors of `values`."""
    scores: tuple[Score, ...]
    """Of all sets that were fitted, the most probable first."""
    p_values: dict[str, float]
    """Effect to the p-value of its gain on confirming frames."""
    refused: dict[str, str]
    """Effects rejected in favour of a discrepancy, and why."""
    dominated: str
    """A discrepancy that explains DOMINATION_RATIO as much as the whole set; '' for none."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Those of `names`, with their values within bounds."""
        return tuple(effect_of(name, self.values) for name in self.names)


def choose(kind: Kind, split: tuple[Frames, Frames, Frames]) -> Chosen:
    """The smallest set within one standard error of the best on the frames that choose."""
    fit_on, choose_on, _ = split
    stretches = np.flatnonzero(np.diff(choose_on, prepend=-2) > 1)
    fits: dict[tuple[str, ...], SetFit] = {}
    scores: dict[tuple[str, ...], Score] = {}

    def attempt(names: tuple[str, ...], discrepancies: str = "") -> float:
        found = kind.fit(names, fit_on, discrepancies)
        if found is None or not (found.matters or discrepancies):
            return -np.inf
        key = (*names, discrepancies) if discrepancies else names
        fits[key] = found
        scores[key] = Score(key, np.add.reduceat(found.judge(choose_on), stretches))
        return scores[key].total

    attempt(())
    beam: list[tuple[str, ...]] = [()]
    best = _smallest(scores, kind.spare)
    while len(beam[0]) <= len(best[0].names) + 1:  # one size beyond the best: pairs may help where singles do not
        wider = {tuple(e for e in kind.effects if e in (*s, more)) for s in beam for more in kind.effects} - set(beam)
        if not wider:
            break
        beam = sorted(sorted(wider), key=attempt, reverse=True)[:BEAM]
        best = _smallest(scores, kind.spare)
    first = best[0]
    none, found = scores[()], fits[first.names]
    gain, refused, dominated = first.total - none.total, dict[str, str](), ""
    for rival in kind.discrepancies if first.names else ():
        attempt((), rival)
        alone = scores[(rival,)]
        if alone.total - none.total > DOMINATION_RATIO * gain:
            dominated = rival
        if not found.sizes:
            continue
        attempt(first.names, rival)
        both = scores[(*first.names, rival)]
        ahead, error = score_difference(alone, first)
        if ahead <= max(error, kind.spare * gain) and both.total - first.total <= gain / DOMINATION_RATIO:
            continue
        brought, error = score_difference(both, alone)
        for name in first.names:
            own, then = found.sizes[name], fits[both.names].sizes[name]
            if np.linalg.norm(then - own) > MAX_SIZE_CHANGE * np.linalg.norm(own) or brought <= error:
                refused[name] = f"errors by {rival} explain more, and beside them it has another size"
    return Chosen(
        kind,
        first.names,
        tuple(s.names for s in best),
        found.values,
        _standard_errors(kind, first.names, fit_on, found.values),
        tuple(sorted(scores.values(), key=lambda s: -s.total)),
        {name: _p_value(kind, fits, first.names, name, split) for name in first.names},
        refused,
        dominated,
    )


def _smallest(scores: dict[tuple[str, ...], Score], spare: float) -> tuple[Score, ...]:
    """The smallest sets within one standard error of the best; also sets that gain all but the share `spare` of the
    best one's."""
    named = list(scores.values())
    best = max(named, key=lambda s: s.total)
    near = [len(s.names) for s in named if s.names and best.total - s.total <= spare * (best.total - scores[()].total)]
    return select_smallest([s for s in named if len(s.names) <= min(near, default=0)])


def _standard_errors(kind: Kind, names: tuple[str, ...], frames: Frames, values: dict[str, float]) -> dict[str, float]:
    """Of the values, by jackknife over `GROUPS` groups of frames."""
    if not names or len(frames) < GROUPS:
        return {}
    again = [kind.fit(names, np.delete(frames, np.s_[g::GROUPS]), "") for g in range(GROUPS)]
    every = [f.values for f in again if f is not None]
    return {name: float(np.sqrt(GROUPS - 1) * np.std([v[name] for v in every])) for name in values if every}


def _p_value(
    kind: Kind,
    fits: dict[tuple[str, ...], SetFit],
    names: tuple[str, ...],
    name: str,
    split: tuple[Frames, Frames, Frames],
) -> float:
    """By sign flips of confirming frames' gains, capped at three times their median size so that one frame does not
    decide."""
    rest = tuple(n for n in names if n != name)
    without = fits.get(rest) or kind.fit(rest, split[0], "") or fits[()]
    gains = fits[names].judge(split[2]) - without.judge(split[2])
    cap = 3 * max(float(np.median(np.abs(gains))), 1e-12)
    at, capped = np.arange(len(gains)), np.clip(gains, -cap, cap)
    z, p, _ = sign_flip_test(at, np.zeros_like(at), capped, 1, np.random.default_rng(13))
    return p if z[0] > 0 else 1.0
