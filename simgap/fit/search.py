"""Search over sets of effects: fits of one, two and three effects, larger sets started from smaller ones."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from itertools import combinations, product

import numpy as np

from freeart21.effects import EFFECTS, Effect
from freeart21.se3 import Array
from simgap.fit import alternatives
from simgap.fit.fit import (
    Fit,
    Model,
    Problem,
    Starts,
    bic_penalty,
    cut_stretches,
    fit_from_small_effects,
    fit_model,
    fit_multiple_shooting,
    initial_theta,
    refit_missed_starts,
    refit_starts,
    residual_dispersion,
    squared_error,
)
from simgap.fit.force_guess import MissingForceSamples, guess_places, sample_missing_force
from simgap.fit.guess import Guess, first_guesses, neutral_point
from simgap.fit.model import ASSET, SHAFT, repeats_family
from simgap.fit.parts import drop_poor_fits, extend_to_all, select_parts
from simgap.measure.data import FitRun

MAX_EFFECTS = 3
CONTENDERS = 8
"""Sets of each size that are evaluated on test runs."""
EXPLAINED = 1.1
"""Normalised RMS of a fit below which no larger set is tried."""
_UNEXPLAINED = 1.35
"""Normalised RMS of the best single effect above which effects without a first guess are fitted, too."""
_SINGLES, _SHORTLIST, _PARENTS, _STARTS = 7, 5, 3, 3
"""Effects fitted alone; sets with one more effect fitted to convergence; sets that larger ones start from; initial
guesses of an effect with a place, width or speed."""
_CROSSINGS = (0.25, 0.8, 2.5, 6.0)
"""Lengths of stretches, in crossings of the range at top speed."""
_USUAL = 2
"""Index of the length used for first-order guesses of all effects. Shorter stretches are used for catches and stops
only, where the asset alone is lost; they hardly show what acts all along."""
_SCREEN = 2
_PLACES = 2
"""Initial guesses from the missing force, for an effect with a place."""
_PARTS, _BACK, _SWINGS = (None, -0.5, 0.0, 0.5), (0.3, 0.85), (0.2, 0.5, 0.8)
"""Multistart grid of a drive on its shaft: share of the asset's inertia uncertainty given to the drive (None for
unchanged), rebound, oscillation time, as shares of their maxima."""
_RESTARTS = 3
"""Points of these grids that are fitted."""
_ALL_ALONG = tuple(
    name
    for name, cls in EFFECTS.items()
    if cls.acts in ("force", "drive") and not (cls.is_local() or cls.reduces_to or cls.geared)
)
"""Losses and forces without a place: they act everywhere."""
LOSSES = tuple(name for name in _ALL_ALONG if EFFECTS[name].dissipates and not EFFECTS[name].needs_load)
"""Effects that dissipate everywhere; every joint has some."""
_SERVO = tuple(name for name, cls in EFFECTS.items() if cls.drivetrain)
"""Effects of a geared drive. Several are needed to come near: on logs of a hobby servo (Rhoban/bam, XL330) Coulomb and
gear friction leave a normalised RMS of 102, with a gain 38, any two or one over 80."""
_HOPEFUL = 6.0
"""Ratio to the least cost on stretches up to which an effect is fitted to whole runs."""
_FAR, _WILD = 2.0, 4.0
"""Normalised RMS above which runs are cut into stretches, and stretches into shorter ones."""
_LOST = 8.0
"""Normalised RMS of a set above which any added effect is first fitted to stretches."""
_GROWING = 4
"""Iterations of a fit to stretches."""


def list_candidates(
    problem: Problem, runs: tuple[FitRun, ...], encoder: bool = True, without: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """Effects that these runs could show, but those of `without`. Without `encoder` positions come from part poses."""
    commanded = any(np.any(run.inputs.effort) or np.isfinite(run.inputs.command).any() for run in runs)
    with_effort = any(np.any(run.inputs.effort) for run in runs)
    near = problem.reaches_limit
    driven = commanded or any(np.any(run.inputs.push) or run.inputs.base_motion is not None for run in runs)
    slack = any(effect.acts == "slack" for effect in problem.plant.effects)

    def possible(cls: type[Effect]) -> bool:
        if problem.plant.joint_type not in cls.joint_types or cls.kind == "kinematics" or not problem.covers_range(cls):
            return False
        if cls.reading_error is not Effect.reading_error and not encoder:
            return False
        if any(s.revolute_unit == "rad/s" and s.lower >= problem.speed for s in cls.parameters().values()):
            return False  # it acts above the largest speed
        if (cls.needs_effort and not with_effort) or (cls.geared and not commanded):
            return False
        if cls.needs_load and not cls.geared and not problem.bearing_loaded:
            return False
        if cls.acts == "command" or cls.acts == "slack":
            return commanded and not (slack and cls.acts == "slack")
        if cls.acts == "stop":
            return near
        return cls.delay is Effect.delay or driven or near

    return tuple(name for name, cls in EFFECTS.items() if possible(cls) and name not in without)


@dataclass
class Search:
    """All fits to the training runs."""

    problem: Problem
    train: tuple[FitRun, ...]
    names: tuple[str, ...]
    """Candidate effects; free shapes (`Effect.complexity` > 1) are fitted separately since they would lead every set.
    """
    seconds: float = np.inf
    """Processor time, s; after half of it no further set is fitted."""
    fits: dict[tuple[str, ...], Fit] = field(default_factory=dict)
    _first_look: tuple[tuple[FitRun, ...], Fit, list[Guess]] | None = None
    _losses: dict[tuple[str, ...], Fit] = field(default_factory=dict)
    """Fits of all sets of losses from small effects."""
    _forces: dict[tuple[str, ...], MissingForceSamples] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._start_time, self.stopped = time.process_time(), False
        self.shapes = tuple(name for name in self.names if EFFECTS[name].complexity > 1)
        self.names = tuple(name for name in self.names if name not in self.shapes)

    @property
    def is_out_of_time(self) -> bool:
        """Whether half of the time is over."""
        self.stopped = self.stopped or time.process_time() > self._start_time + 0.5 * self.seconds
        return self.stopped

    @property
    def is_overtime(self) -> bool:
        """Whether all of the time is over."""
        late = time.process_time() > self._start_time + self.seconds
        self.stopped = self.stopped or late
        return late

    def base(self) -> Fit:
        """No effect missing, only errors of the asset."""
        if () not in self.fits:
            self.fits[()] = fit_multiple_shooting(Model(self.problem, ()), self.train)
        return self.fits[()]

    def is_promising(self) -> bool:
        """Whether any effect improves the fit by more than its parameters cost, to first order."""
        base, (cut, at, found) = self.base(), self._look_first()
        if cut is not self.train:
            return True
        return any(self._is_paid(base, guess, at.rss - guess.cost) for guess in found)

    def _is_paid(self, fit: Fit, guess: Guess, gain: float) -> bool:
        """Whether a decrease of a fit's sum of squares exceeds the BIC penalty of a guess."""
        readings = sum(len(run.q) for run in self.train)
        return 0.5 * gain / residual_dispersion(fit.residuals) > bic_penalty(len(guess.point), readings)

    def explore(self) -> list[Fit]:
        """The best sets of every size; for long runs found on parts of them and then fitted to all."""
        parts = select_parts(self.problem, self.train)
        if parts is self.train or self.base().rms <= _FAR:
            return self._explore_sizes()
        short = Search(self.problem, parts, self.names + self.shapes, 0.5 * self.seconds)
        near = sorted(drop_poor_fits(short._explore_sizes(), _HOPEFUL), key=lambda fit: len(fit.model.names))
        self.stopped = short.stopped
        found = [self.keep(extend_to_all(fit, self.train)) for fit in near]
        for size in range(1, MAX_EFFECTS + 1):
            for fit in self._of_size(size)[:_PARENTS]:
                # only one of two confounded effects may have found the better optimum
                for at in alternatives.find_confounded(self.problem, fit, self.names):
                    found.append(self.keep(fit_model(at.model, self.train, at.theta, at.starts)))
        for fit in sorted(self.fits.values(), key=lambda fit: fit.cost):
            for name in fit.model.names:
                self._from_above(fit, name)
        return [self.fits[names] for names in dict.fromkeys(fit.model.names for fit in found)]

    def _from_above(self, fit: Fit, name: str) -> None:
        """A subset that fits worse than with the parameters of the larger set, refitted from there."""
        names = tuple(n for n in fit.model.names if n != name)
        if names in self.fits:
            model = Model(self.problem, names)
            theta = initial_theta(model, fit, {})
            if squared_error(model, self.train, theta, fit.starts) < self.fits[names].cost:
                self.keep(fit_model(model, self.train, theta, fit.starts))

    def _explore_sizes(self) -> list[Fit]:
        """The best sets of every size, until nothing is left to explain; started from smaller sets, from small effects,
        and from alternatives."""
        level = self.fit_singles()
        for size in range(1, MAX_EFFECTS + 1):
            if size > 1:
                level = self.fit_larger(level[: _PARENTS if size == 2 else _PARENTS - 1])
            self._fit_swaps(size)
            level = self._of_size(size)
            if self._is_explained() or self.is_out_of_time:
                break
        every = [] if self._is_explained() else [fit for fit in self.fit_losses() if self.base().rms > _FAR]
        best = [fit for k in range(1, size + 1) for fit in self._of_size(k)[:CONTENDERS]]
        names = {fit.model.names for fit in best}
        return best + [fit for fit in every if fit.model.names not in names]

    def _is_explained(self) -> bool:
        """Whether a set leaves hardly more than noise."""
        return min(self.fits.values(), key=lambda fit: fit.cost).rms < EXPLAINED

    def _of_size(self, size: int) -> list[Fit]:
        """All fits of sets of this size, best first."""
        return sorted((fit for names, fit in self.fits.items() if len(names) == size), key=lambda fit: fit.cost)

    def _fit_swaps(self, size: int) -> None:
        """Fits of the best sets with an effect replaced by an alternative, reduced, or removed; of the very best only
        when time is over."""
        for fit in self._of_size(size)[: 1 if self.is_out_of_time else _PARENTS]:
            for at in alternatives.find_alternatives(self.problem, fit, self.names):
                if EFFECTS[at.new].reduces_to != at.old.name:  # that one is started from its reduced form
                    self.keep(fit_model(at.model, self.train, at.theta, at.starts))
            for name in fit.model.names:
                rest = {*fit.model.names} - {name}
                less = EFFECTS[name].reduces_to
                if less in self.names:
                    self.fit_set(tuple(sorted({*rest, less})))
                if rest:
                    self.fit_without(fit, name)

    def fit_shapes(self) -> list[Fit]:
        """Fits of free shapes, alone and with the best losses."""
        lossy = sorted((f for f in self.fits.values() if f.model.names in loss_sets(self.names)), key=lambda f: f.cost)
        other_effects = [(), *(fit.model.names for fit in lossy[:2])]
        sets = [tuple(sorted((*names, shape))) for shape in self.shapes for names in other_effects]
        return [
            self.keep(fit_from_small_effects(Model(self.problem, names), self.train))
            for names in sets
            if not (repeats_family(names) or self.is_out_of_time)
        ]

    def fit_losses(self) -> list[Fit]:
        """Fits of all `loss_sets` from small effects, not from a biased asset."""
        for names in loss_sets(self.names):
            if names not in self._losses and not self.is_out_of_time:
                self._losses[names] = fit_from_small_effects(Model(self.problem, names), self.train)
        own = self._losses.items()
        return [min((fit, self.fits.get(names, fit)), key=lambda f: f.cost) for names, fit in own]

    def _with_losses(self, size: int) -> list[Fit]:
        """Those of a size that fit better than the same set, or than all found; the others are no use to the search."""
        if self.base().rms <= _FAR or self._is_explained():
            return []
        level = [fit.cost for names, fit in self.fits.items() if len(names) == size]
        found = []
        for fit in self.fit_losses():
            names = fit.model.names
            known = self.fits.get(names)
            if len(names) == size and fit.cost < (known.cost if known is not None else min(level, default=np.inf)):
                found.append(self.keep(fit))
        return found

    def _look_first(self) -> tuple[tuple[FitRun, ...], Fit, list[Guess]]:
        """Stretches for first-order guesses, the asset alone fitted to them, and guesses of every effect."""
        if self._first_look is None:
            cut, at = self._choose_stretches(self.base(), True)
            self._first_look = cut, at, first_guesses(at, cut, self.names)
        return self._first_look

    def fit_singles(self) -> list[Fit]:
        """Every effect alone, best first."""
        cut, at, found = self._look_first()
        rough = []
        for name in list(dict.fromkeys(guess.name for guess in found))[:_SINGLES]:
            points = [guess.point for guess in self._select_distinct([guess for guess in found if guess.name == name])]
            rough.append(self._best_start(name, points, cut, at))
        rough = self._refine_sudden(rough, cut, at)
        most = CONTENDERS + 1
        for fewer, runs in enumerate(self._longer_stretches(cut)):
            rough = [self._fit_stretched(fit, runs) for fit in _drop_poor(rough)[: most - fewer]]
        for fit in _drop_poor(rough)[:most]:
            self.keep(self._fit_whole(fit, self.base()) if cut is not self.train else self._finish(fit))
        self._with_losses(1)
        far = self._fit_remaining()
        for name in self.names:
            reduced = EFFECTS[name].reduces_to
            if reduced and (name,) in self.fits and (reduced,) in self.fits:
                self._keep_from(name, self.fits[(reduced,)])
                self._keep_reduced(self.fits[(name,)], reduced)
            if reduced and EFFECTS[name].acts == "slack" and {(name,), (reduced,)} <= {*self.fits}:
                self._fit_slack(name, self.fits[(reduced,)])
        return self._refit_level(
            [self.fits[(name,)] for name in self.names if (name,) in self.fits and name not in far]
        )

    def _fit_remaining(self) -> list[str]:
        """Where no effect alone explains the runs: fits of those that first guesses do not reach (stops, strong
        damping, stiction). Returns those that act everywhere and are worse than all others."""
        if min((fit.rms for fit in self.fits.values()), default=np.inf) <= _UNEXPLAINED:
            return []
        for name in self.names if not self.is_out_of_time else ():
            if EFFECTS[name].acts == "stop":
                self.fit_set((name,))
        looked = LOSSES if self._losses else ()
        new = [
            n
            for n in _ALL_ALONG
            if n in self.names and (n,) not in self.fits and n not in looked and not self.is_out_of_time
        ]
        least = min(fit.cost for fit in self.fits.values())
        return [name for name in new if self.fit_set((name,)).cost >= least]

    def _fit_slack(self, name: str, reduced: Fit) -> None:
        """A slack, started from its drive's inertia without one: with a wrong width all impacts are displaced."""
        begin = alternatives.find_alternatives(self.problem, reduced, (name,))
        if self.fits[(name,)].cost < reduced.cost or next(iter(reduced.effects)).added_inertia() <= 0:
            return
        best = fit_best_start(begin[0].model, [at.theta for at in begin], self.train, reduced.starts, _SCREEN)
        self.keep(fit_model(best.model, self.train, best.theta, best.starts))

    def _select_distinct(self, own: list[Guess]) -> list[Guess]:
        """The best guesses of one effect that are not neighbours on the grid."""
        distinct: list[Guess] = []
        for guess in own:
            if len(distinct) < _STARTS and not any(self._is_similar(guess, other) for other in distinct):
                distinct.append(guess)
        return distinct

    def _is_similar(self, first: Guess, second: Guess) -> bool:
        """Whether two guesses differ only in size: places within a tenth of the range, widths and speeds within a
        factor of 2."""
        reach = 0.1 * (self.problem.q_high - self.problem.q_low)
        own = [r for r in Model(self.problem, (first.name,)).ranges() if r.owner == first.name]
        for r in own[1:]:
            a, b = first.point[r.name], second.point[r.name]
            if abs(a - b) > reach if r.lower < 0 else max(a, b) > 2 * min(a, b):
                return False
        return True

    def _refine_sudden(self, rough: list[Fit], cut: tuple[FitRun, ...], at: Fit) -> list[Fit]:
        """The fits to stretches, with those of catches and stops started on shorter ones."""
        short = self._shorter_stretches(self.base(), at, True)
        if short is None:
            return rough
        found = first_guesses(short[1], short[0], tuple(name for name in self.names if is_sudden(EFFECTS[name])))
        best = {fit.model.names: fit for fit in rough}
        for name in dict.fromkeys(guess.name for guess in found):
            own = self._select_distinct([guess for guess in found if guess.name == name])
            fit = self._best_start(name, [guess.point for guess in own] + self._guess_places(name), *short)
            fit = self._fit_longer(fit, short[0], len(cut))
            fit = min(fit, best.get((name,), fit), key=lambda f: f.cost)
            best[(name,)] = fit
        return list(best.values())

    def _fit_longer(self, fit: Fit, cut: tuple[FitRun, ...], fewest: int = 0) -> Fit:
        """The fit on ever longer stretches, down to a number of them."""
        for runs in self._longer_stretches(cut):
            if len(runs) >= fewest:
                fit = self._fit_stretched(fit, runs)
        return fit

    def _best_start(self, name: str, points: list[dict[str, float]], cut: tuple[FitRun, ...], at: Fit) -> Fit:
        """`at`, a fit to stretches, with the effect added from the best of these points."""
        model = Model(self.problem, tuple(sorted((*at.model.names, name))))
        return fit_best_start(model, [initial_theta(model, at, {name: point}) for point in points], cut, at.starts)

    def _guess_places(self, name: str, other_effects: tuple[Effect, ...] = ()) -> list[dict[str, float]]:
        """Initial guesses of an effect with a place, from the missing force."""
        key = tuple(effect.name for effect in other_effects)
        if key not in self._forces:
            self._forces[key] = sample_missing_force(self.problem, self.train, other_effects)
        return guess_places(self.problem, self._forces[key], name, _PLACES)

    def _longer_stretches(self, cut: tuple[FitRun, ...]) -> list[tuple[FitRun, ...]]:
        """The runs cut into longer and longer stretches, without whole runs."""
        found, count = [], len(cut)
        for crossings in _CROSSINGS:
            runs = cut_stretches(self.train, crossings * self.problem.crossing_s)
            if len(self.train) < len(runs) < count:
                found.append(runs)
                count = len(runs)
        return found

    def _fit_stretched(self, fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
        """The fit on longer stretches."""
        longer = fit_model(fit.model, runs, fit.theta, fit.starts, _GROWING)
        return refine_multistart(longer, runs)

    def _fit_whole(self, fit: Fit, parent: Fit) -> Fit:
        """A fit to stretches extended to whole runs, from its own start states or its parent's."""
        first = {run.name: fit.starts[f"{run.name}#0"] for run in self.train}
        ways = [fit_model(fit.model, self.train, fit.theta, at, _SCREEN) for at in (first, parent.starts)]
        return self._finish(min(ways, key=lambda way: way.cost))

    def _finish(self, fit: Fit) -> Fit:
        """The fit to whole runs, to convergence."""
        fit = refine_multistart(fit, self.train)
        return fit_model(fit.model, self.train, fit.theta, fit.starts)

    def _keep_from(self, name: str, reduced: Fit) -> None:
        """Refit a general effect from the one that it reduces to, which it cannot fit worse than."""
        fit = self.fits[(name,)]
        shared = {key: float(x) for (owner, key), x in reduced.values.items() if owner in reduced.model.names}
        if fit.cost > reduced.cost and set(shared) <= set(EFFECTS[name].parameters()):
            point = {**neutral_point(self.problem, name), **shared}
            theta = initial_theta(fit.model, reduced, {name: point})
            self.keep(fit_model(fit.model, self.train, theta, reduced.starts))

    def _keep_reduced(self, general: Fit, reduced: str) -> None:
        """Refit a reduced effect from the general one where it fits worse."""
        if general.cost < self.fits[(reduced,)].cost:
            self.keep(reduce_effect(general, general.model.names[0], self.train))

    def fit_larger(self, parents: list[Fit]) -> list[Fit]:
        """The most promising sets with one more effect than `parents`, fitted, at least one for each parent. Sudden
        effects cost most time and are tried only where they promise more than their penalty."""
        rough: dict[tuple[str, ...], tuple[float, Fit, Guess, Fit, tuple[FitRun, ...]]] = {}
        for parent in parents:
            cut, at = self._choose_stretches(parent)
            scale = parent.cost / max(at.rss, 1e-9)  # cost of whole runs per cost of stretches
            for guess in first_guesses(at, cut, self.names):
                names = tuple(sorted((*parent.model.names, guess.name)))
                if repeats_family(names):
                    continue
                cost = guess.cost * scale
                if is_sudden(EFFECTS[guess.name]) and not self._is_paid(parent, guess, parent.cost - cost):
                    continue
                if names not in self.fits and (names not in rough or cost < rough[names][0]):
                    rough[names] = (cost, parent, guess, at, cut)
        order = sorted(rough.values(), key=lambda entry: entry[0])
        firsts = [next(e for e in order if e[1] is parent) for parent in parents if any(e[1] is parent for e in order)]
        best = (firsts + [e for e in order if not any(e is f for f in firsts)])[:_SHORTLIST]
        for entry in tuple(best):
            reduced = EFFECTS[entry[2].name].reduces_to
            other = rough.get(tuple(sorted((*entry[1].model.names, reduced)))) if reduced else None
            if other is not None and not any(e is other for e in best):
                best.append(other)  # it is preferred when it fits as well
        damped = [e for e in order if _hides_damping(e[1]) and EFFECTS[e[2].name].damping is not Effect.damping]
        best += [entry for entry in damped if not any(e is entry for e in best)]
        level = [self._fit_added(*entry[1:]) for entry in best if not self.is_out_of_time]
        lost = self._with_losses(len(parents[0].model.names) + 1)
        known = {fit.model.names for fit in level}
        return self._refit_level(level + [fit for fit in lost if fit.model.names not in known])

    def _refit_level(self, level: list[Fit]) -> list[Fit]:
        """The sets sorted, the best with a new search of start states."""
        level = sorted(level, key=lambda fit: fit.cost)
        for fit in level[:_PARENTS]:
            self.fits[fit.model.names] = refit_missed_starts(fit, self.train)
        return sorted((self.fits[fit.model.names] for fit in level), key=lambda fit: fit.cost)

    def _fit_added(self, parent: Fit, guess: Guess, at: Fit, cut: tuple[FitRun, ...]) -> Fit:
        """The parent's set with the guessed effect, started from the parent's fit (`at` on stretches)."""
        model = Model(self.problem, tuple(sorted((*parent.model.names, guess.name))))
        points = [guess.point]
        alone = self.fits.get((guess.name,))
        if alone is not None:
            values = zip(alone.model.ranges(), alone.theta, strict=True)
            points.append({r.name: float(x) for r, x in values if r.owner == guess.name})
        sudden = is_sudden(EFFECTS[guess.name])
        if cut is self.train or not (sudden or parent.rms > _LOST):
            # a smooth effect is found from the parent's own simulation
            points_at = [initial_theta(model, parent, {guess.name: point}) for point in points]
            return self.keep(self._finish(fit_best_start(model, points_at, self.train, parent.starts, _SCREEN)))
        begin = (self._shorter_stretches(parent, at, False) if sudden else None) or (cut, at)
        fit = self._best_start(guess.name, points + self._guess_places(guess.name, parent.effects), *begin)
        return self.keep(self._fit_whole(self._fit_longer(fit, begin[0]), parent))

    def fit_set(self, names: tuple[str, ...]) -> Fit:
        """The fit of this set, started from its best subset."""
        if names not in self.fits:
            smaller = [self.fits[s] for n in names if (s := tuple(m for m in names if m != n)) in self.fits]
            parent = min(smaller, key=lambda fit: fit.cost) if smaller else self.base()
            new = tuple(n for n in names if n not in parent.model.names)
            if len(new) > 1:
                parent = self.fit_set(names[:-1])
                new = names[-1:]
            cut, at = self._choose_stretches(parent)
            self._fit_added(parent, first_guesses(at, cut, new)[0], at, cut)
        return self.fits[names]

    def fit_without(self, fit: Fit, name: str) -> Fit:
        """The set of `fit` without one effect, started from `fit`."""
        return self.keep(remove_effect(fit, name, self.train))

    def keep(self, fit: Fit) -> Fit:
        """Store a fit, after making sure that it is no worse than any subset's."""
        for name in fit.model.names:
            smaller = self.fits.get(tuple(n for n in fit.model.names if n != name))
            if smaller is not None and smaller.cost < fit.cost - 1e-3 - 1e-6 * fit.cost:
                theta = initial_theta(fit.model, smaller, {name: neutral_point(self.problem, name)})
                again = fit_model(fit.model, self.train, theta, smaller.starts)
                fit = min(fit, again, key=lambda f: f.cost)
        known_fit = self.fits.get(fit.model.names)
        self.fits[fit.model.names] = fit if known_fit is None or fit.cost < known_fit.cost else known_fit
        return self.fits[fit.model.names]

    def _choose_stretches(self, fit: Fit, free: bool = False) -> tuple[tuple[FitRun, ...], Fit]:
        """The runs whole where linearisation holds, else in stretches, and the fit on them; its parameters are refitted
        if `free`."""
        if fit.rms < _FAR:
            return self.train, clamp_starts(fit)
        return self._fit_pieces(fit, _CROSSINGS[_USUAL], free)

    def _shorter_stretches(self, fit: Fit, at: Fit, free: bool) -> tuple[tuple[FitRun, ...], Fit] | None:
        """Stretches on which the fit holds, and the fit there; None where `at` holds on the usual ones."""
        found = None
        for crossings in _CROSSINGS[:_USUAL][::-1]:
            if (found[1] if found else at).rms < _WILD:
                break
            found = self._fit_pieces(fit, crossings, free)
        return found

    def _fit_pieces(self, fit: Fit, crossings: float, free: bool) -> tuple[tuple[FitRun, ...], Fit]:
        cut = cut_stretches(self.train, crossings * self.problem.crossing_s)
        at = fit_model(fit.model, cut, fit.theta, None, _GROWING) if free else refit_starts(fit, cut)
        return cut, clamp_starts(at)


def fit_best_start(
    model: Model, points: list[Array], runs: tuple[FitRun, ...], starts: Starts, iterations: int = _GROWING
) -> Fit:
    """The best of a few iterations from each of the points."""
    return min((fit_model(model, runs, point, starts, iterations) for point in points), key=lambda fit: fit.cost)


def refine_multistart(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit after trying points that no gradient leads to: place and travel of a catch, and the rebound of a drive at
    a limit."""
    points = [*_restart_points(fit), *_shaft_points(fit)]
    if not points:
        return fit
    low, high = (np.array([getattr(r, k) for r in fit.model.ranges()]) for k in ("lower", "upper"))
    tried = [np.clip(theta, low, high) for theta in points]
    order = np.argsort([squared_error(fit.model, runs, theta, fit.starts) for theta in tried], kind="stable")
    best = [fit.theta, *(tried[i] for i in order[:_RESTARTS])]
    return min(fit, fit_best_start(fit.model, best, runs, fit.starts, _SCREEN), key=lambda f: f.cost)


def _restart_points(fit: Fit) -> list[Array]:
    """(p,) points about a fit with an effect at another of its `Effect.restarts`."""
    found = []
    for effect in fit.effects:
        for point in effect.restarts():
            theta = fit.theta.copy()
            for i, r in enumerate(fit.model.ranges()):
                if r.owner == effect.name:
                    theta[i] = point[r.name]
            found.append(theta)
    return found


def _shaft_points(fit: Fit) -> list[Array]:
    """(p,) points about a fit with the same total inertia and another share and rebound of the drive."""
    at = {(r.owner, r.name): i for i, r in enumerate(fit.model.ranges())}
    if (SHAFT, "swing") not in at:
        return []
    own = fit.model.problem.plant.mechanics.inertia
    drive = next(at[cls.name, cls.rotor_fields[0]] for cls in fit.model.classes if len(cls.rotor_fields) > 2)
    part, doubt, found = at.get((ASSET, "inertia")), fit.model.problem.inertia_relative, []
    for taken, back, swing in product(_PARTS if part is not None else _PARTS[:1], _BACK, _SWINGS):
        theta = fit.theta.copy()
        theta[[at[SHAFT, "rebound"], at[SHAFT, "swing"]]] = back, swing
        if taken is not None:
            theta[drive] += (theta[part] - (1 + taken * doubt)) * own
            theta[part] = 1 + taken * doubt
        found.append(theta)
    return found


def loss_sets(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Sets of one to three losses among `names`, and of up to four drive effects where one is geared."""
    sets = [s for k in (1, 2, 3) for s in combinations(LOSSES, k)]
    if any(EFFECTS[name].geared for name in names):
        sets += [s for k in (1, 2, 3, 4) for s in combinations(_SERVO, k) if s not in sets]
    return [s for s in sets if set(s) <= set(names)]


def _hides_damping(fit: Fit) -> bool:
    """Whether the set has a rotor or slack; until these fit, damping looks like a delay."""
    return any(cls.rotor_fields for cls in fit.model.classes)


def is_sudden(cls: type[Effect]) -> bool:
    """Whether an effect changes motion abruptly: a stop or a force at a place."""
    return cls.acts == "stop" or cls.is_local()


def clamp_starts(fit: Fit) -> Fit:
    """The fit with start states that run into a limit clamped to rest there; a dead stop makes no difference."""
    plant, near = fit.model.problem.plant, 2 * fit.model.problem.sigma
    if any(cls.acts == "stop" for cls in fit.model.classes):
        return fit
    starts = {}
    for name, (q, v) in fit.starts.items():
        below, above = q < plant.lower + near and v < 0, q > plant.upper - near and v > 0
        starts[name] = (plant.lower, 0.0) if below else ((plant.upper, 0.0) if above else (q, v))
    return replace(fit, starts=starts)


def _drop_poor(fits: list[Fit]) -> list[Fit]:
    """The fits to the same runs, best first, without those far behind."""
    order = sorted(fits, key=lambda fit: fit.cost)
    return [fit for i, fit in enumerate(order) if i < 2 or fit.cost < _HOPEFUL * order[0].cost]


def drop_presliding(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The same set refitted with friction without presliding."""
    model = Model(fit.model.problem, fit.model.names, instant_friction=True)
    if len(model.ranges()) == len(fit.theta):
        return fit
    return refit_missed_starts(fit_model(model, runs, initial_theta(model, fit, {}), fit.starts), runs)


def drop_least_presliding(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit, or without presliding where that is better and the least travel is still too much: a joint that sticks
    while it is pushed back and forth shows it."""
    travel = [r.lower == x for r, x in zip(fit.model.ranges(), fit.theta, strict=True) if r.name == "travel_root"]
    return min((fit, drop_presliding(fit, runs)), key=lambda f: f.cost) if any(travel) else fit


def reduce_effect(fit: Fit, name: str, runs: tuple[FitRun, ...]) -> Fit:
    """The fit with an effect replaced by the one it reduces to, started from the parameters of both."""
    reduced = EFFECTS[name].reduces_to or name
    model = replace(fit.model, names=tuple(sorted({*fit.model.names, reduced} - {name})))
    shared = {
        key: x for (owner, key), x in fit.values.items() if owner == name and key in EFFECTS[reduced].parameters()
    }
    return fit_model(model, runs, initial_theta(model, fit, {reduced: shared}), fit.starts)


def simplify(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit, with effects replaced by those that they reduce to, or removed, where that fits no worse."""
    for name in fit.model.names:
        sizes, less = {e.name: e.values()[0] for e in fit.effects}, []
        if EFFECTS[name].reduces_to and EFFECTS[name].reduces_to not in sizes:
            less.append(reduce_effect(fit, name, runs))
        if len(sizes) > 1 and sizes[name] == EFFECTS[name].neutral:
            less.append(remove_effect(fit, name, runs))
        fit = next((f for f in less if f.cost <= fit.cost + 1e-3 + 1e-6 * fit.cost), fit)
    return fit


def remove_effect(fit: Fit, name: str, runs: tuple[FitRun, ...]) -> Fit:
    """The fit without an effect, started from its parameters."""
    model = replace(fit.model, names=tuple(n for n in fit.model.names if n != name))
    return fit_model(model, runs, initial_theta(model, fit, {}), fit.starts)
