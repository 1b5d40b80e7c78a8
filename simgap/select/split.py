"""Three kinds of runs: those that sets are fitted to, those that choose among sets, and those that confirm the choice.

A run that chose is no witness any more: of forty sets the one that suits it best does so by chance, too. What is said
of a gap before and after is said of confirming runs alone, where there are runs enough to keep some for that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from simgap.measure.data import FitRun
from simgap.measure.swings import reversals
from simgap.verdict import Use

_GROUPS = 4
"""Of runs that nobody marked, that are left out in turn: each of the fits then has three quarters of them."""
_CONFIRM_EVERY = 5
"""Of this many unmarked runs one confirms; fewer are all needed to fit and to choose."""

_TURN_SHARE = 0.1
"""Of the range of a run, a way back that counts as a turn, as where half swings are counted (`equation_error`)."""


@dataclass(frozen=True)
class Fold:
    """Runs to fit, and runs to predict."""

    train: tuple[FitRun, ...]
    test: tuple[FitRun, ...]


@dataclass(frozen=True)
class Split:
    """What each run is used for."""

    folds: tuple[Fold, ...]
    """One where runs were marked; else several, and every run of theirs is fitted and chooses in turn."""
    confirming: tuple[FitRun, ...]
    """Runs that neither fits nor the choice have seen; none where there are too few runs."""

    @property
    def train_runs(self) -> tuple[FitRun, ...]:
        """What the sets are searched on: all but what is kept back for good."""
        if len(self.folds) == 1:
            return self.folds[0].train
        return tuple(run for fold in self.folds for run in fold.test)

    def use(self, run: str) -> Use:
        """Of a run by its name; one that is fitted and chooses in turn is fitted."""
        if run in {r.name for r in self.confirming}:
            return "confirming"
        marked = len(self.folds) == 1 and run in {r.name for r in self.folds[0].test}
        return "choosing" if marked else "fitted"


def split_runs(runs: tuple[FitRun, ...]) -> Split:
    """Runs that are marked as held out choose and confirm by turns, in order of how they move; without marks each run
    is left out in turn, in at most four groups of like size of motion, and of five or more some confirm.

    A single run is cut into three stretches, or into so many that one may confirm where each then has two swings.
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
    kept = [run for run in order if run not in confirming]
    groups = [[kept[i] for i in g] for g in np.array_split(np.arange(len(kept)), min(len(kept), _GROUPS))]
    return Split(
        tuple(Fold(tuple(r for other in groups if other is not g for r in other), tuple(g)) for g in groups),
        confirming,
    )


def _motion_key(run: FitRun) -> tuple[str, float]:
    """Kind and size of a run's motion."""
    return run.regime, float(np.mean(run.speed**2))


def _cut_run(run: FitRun, begin: int, end: int) -> FitRun:
    return replace(run.between(begin, end), name=f"{run.name}#{begin}")
