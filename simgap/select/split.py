"""Runs to fit sets, to choose among them, and to confirm the choice.

A run that was used to choose cannot confirm: of forty sets the best one is partly best by chance. Gaps before and after
are reported for confirming runs alone, where there are enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from simgap.measure.data import FitRun
from simgap.measure.swings import reversals
from simgap.verdict import Use

_GROUPS = 4
"""Folds of unmarked runs: each fit then has three quarters of them."""
_CONFIRM_EVERY = 5
"""Of this many unmarked runs one confirms; fewer are all needed to fit and to choose."""

_TURN_SHARE = 0.1
"""Share of a run's range by which it must turn back to count as a swing."""


@dataclass(frozen=True)
class Fold:
    """Training and test runs."""

    train: tuple[FitRun, ...]
    test: tuple[FitRun, ...]


@dataclass(frozen=True)
class Split:
    """The use of every run."""

    folds: tuple[Fold, ...]
    """One when runs were marked as held out; else several, in which every run is test run once."""
    confirming: tuple[FitRun, ...]
    """Runs that neither fits nor the choice see; none where there are too few."""

    @property
    def train_runs(self) -> tuple[FitRun, ...]:
        """Runs of the search: all but those held out for good."""
        if len(self.folds) == 1:
            return self.folds[0].train
        return tuple(run for fold in self.folds for run in fold.test)

    def use(self, run: str) -> Use:
        """Use of a run by name; runs that are tested in turn count as fitted."""
        if run in {r.name for r in self.confirming}:
            return "confirming"
        marked = len(self.folds) == 1 and run in {r.name for r in self.folds[0].test}
        return "choosing" if marked else "fitted"


def split_runs(runs: tuple[FitRun, ...]) -> Split:
    """Held-out runs alternately choose and confirm, ordered by their motion. Without marks each run is left out in
    turn, in at most four groups of similar motion, and of five or more some confirm.

    A single run is cut into three stretches, or five when each then has four half swings.
    """
    back = sorted((run for run in runs if run.held_out), key=_motion_key)
    if back:
        train = tuple(run for run in runs if not run.held_out)
        return Split((Fold(train, tuple(back[::2])),), tuple(back[1::2]))
    if len(runs) == 1:
        turns = len(reversals(runs[0].q, _TURN_SHARE * float(np.ptp(runs[0].q))))
        bounds = np.linspace(0, len(runs[0].q), (_CONFIRM_EVERY if turns >= 4 * _CONFIRM_EVERY else 3) + 1).astype(int)
        runs = tuple(_cut_run(runs[0], int(a), int(b)) for a, b in pairwise(bounds))
    order = sorted(runs, key=_motion_key)
    confirming = tuple(order[_CONFIRM_EVERY // 2 :: _CONFIRM_EVERY]) if len(order) >= _CONFIRM_EVERY else ()
    fitted = [run for run in order if run not in confirming]
    groups = [[fitted[i] for i in g] for g in np.array_split(np.arange(len(fitted)), min(len(fitted), _GROUPS))]
    return Split(
        tuple(Fold(tuple(r for other in groups if other is not g for r in other), tuple(g)) for g in groups),
        confirming,
    )


def _motion_key(run: FitRun) -> tuple[str, float]:
    """Regime and mean squared speed of a run."""
    return run.regime, float(np.mean(run.speed**2))


def _cut_run(run: FitRun, begin: int, end: int) -> FitRun:
    return replace(run.between(begin, end), name=f"{run.name}#{begin}")
