"""Which explanation stands: the smallest set of effects that predicts runs it never saw, and its rivals.

A real effect is never just the library's formula, so a set explains the runs when they are met with the sizes of its
effects free to depart from their formulas by the form tolerance. What is named is the smallest set that does; sets of
that size that do as well by their plain formulas are rivals. When none does, nothing is named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.stats import norm

from freeart21.effects import EFFECTS, Effect
from freeart21.effects.stribeck_friction import StribeckFriction
from freeart21.se3 import Array
from simgap import alike
from simgap.ceiling import ceiling
from simgap.data import FitRun
from simgap.drift import Drift, drift_of
from simgap.fit import Fit, fitted, foretold, steady, tempered, unit_of
from simgap.search import PLAINER, Search, is_sudden, prompt, relaxed
from simgap.settings import ChoiceSettings
from simgap.theory import SHAFT, Reader

_EDGE = 0.02
"""Part of a range that counts as its end."""
_SPRINGY = 0.05
"""The same of what a shaft gives back."""
_NARROW = 0.5
"""Part by which a slack must be wider than the narrowest that can be told from a shaft that twists."""
_CAPTURE = 0.1
"""The same of a catch's way."""
_RUNS = 4
"""Held-out runs of which one may be missed."""
_NEAR = 0.5
"""Part of the gap that a single effect may leave and still be asked whether it changes over the session."""
_RISE = 0.1
"""Part of the level of dry friction below which a rise at rest is none."""
_ANEW = 0.5
"""Part of its sum of squares to which a set must fall to be looked at again."""


@dataclass(frozen=True)
class Fold:
    """Runs to fit, and runs to predict."""

    train: tuple[FitRun, ...]
    test: tuple[FitRun, ...]


@dataclass(frozen=True)
class Judged:
    """A set of effects before runs it never saw."""

    fit: Fit
    strict: dict[str, Array]
    """Held-out residuals over the floor by run, by the plain formulas."""
    loose: dict[str, Array] | None = None
    """The same with the sizes free within the form tolerance."""
    free: Fit | None = None
    """To the runs that were fitted, with the sizes free so."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return self.fit.theory.names

    @property
    def floors(self) -> float:
        """Root mean square of the held-out residuals, in floors."""
        return _rms(self.strict)

    @cached_property
    def error(self) -> float:
        """The same, runs that are missed by far counting for less: what sets are compared by."""
        return _rms(tempered(self.strict))

    @cached_property
    def learned(self) -> float:
        """The same of the runs that it was fitted to."""
        return _rms(self.fit.tempered)

    @cached_property
    def reach(self) -> float:
        """The error with the sizes free, or without, whichever is less."""
        return _rms(tempered(self.left))

    @property
    def borne(self) -> float:
        """What is left in floors, without the run that is met worst, of four or more: what grazes a stop or just passes
        a notch hangs on a hair, and no formula is that near."""
        return _rms(_but_worst(self.left))

    @property
    def left(self) -> dict[str, Array]:
        """What is left with the sizes free, or without, whichever is less: form that is explained is no noise."""
        return self.strict if self.loose is None or _rms(tempered(self.loose)) > self.error else self.loose


@dataclass(frozen=True)
class Choice:
    """What stands."""

    base: Judged
    p_value: float
    """That a gap this clear comes of noise, over all effects that were tried."""
    explaining: tuple[Judged, ...]
    """Rivals, the best first; empty when there is no gap, or nothing explains it."""
    best: Judged
    """The best set that was found, whether it explains the gap or not."""
    bar: float
    """Floors that an explanation may leave."""
    gap: bool
    tried: tuple[Judged, ...] = ()
    drift: Drift | None = None
    """What speaks against the best set, or would against the nearest single effect."""


def folds_of(runs: tuple[FitRun, ...]) -> tuple[Fold, ...]:
    """Held-out runs as marked; without marks each run is held out in turn, at most four groups of like size of motion.

    A single run is cut into three stretches.
    """
    if any(run.held_out for run in runs):
        return (Fold(tuple(r for r in runs if not r.held_out), tuple(r for r in runs if r.held_out)),)
    if len(runs) == 1:
        bounds = np.linspace(0, len(runs[0].q), 4).astype(int)
        runs = tuple(_stretch(runs[0], int(a), int(b)) for a, b in pairwise(bounds))
    order = np.argsort([np.mean(run.speed**2) for run in runs], kind="stable")
    groups = [set(map(int, g)) for g in np.array_split(order, min(len(runs), 4))]
    return tuple(
        Fold(tuple(r for i, r in enumerate(runs) if i not in g), tuple(r for i, r in enumerate(runs) if i in g))
        for g in groups
    )


def _stretch(run: FitRun, begin: int, end: int) -> FitRun:
    return replace(run.between(begin, end), name=f"{run.name}#{begin}")


def chosen(search: Search, folds: tuple[Fold, ...], settings: ChoiceSettings) -> Choice:
    """The smallest explanation, or none."""
    base = judged(search.base(), folds)
    quiet = max(base.error, base.learned) < settings.explained
    if quiet and search.hinted() < settings.hint * settings.least_gap:
        return Choice(base, 1.0, (), base, settings.explained, False)
    level = search.singles()
    first = [judged(fit, folds) for fit in level[: settings.contenders]]
    tried = list(first)
    best = min(first, key=lambda j: j.error)
    p = p_value(base, first[0], search.tries)
    closed = np.sqrt(max(base.error**2 - best.error**2, 0.0))
    bar = float(np.hypot(settings.explained, settings.explained_part * base.floors))
    clear = max(base.borne, _rms(_but_worst(base.fit.residuals))) > settings.plain_gap
    gap = bool((p < settings.p_value and closed > settings.least_gap) or clear)
    if not gap:
        return Choice(base, p, (), best, bar, False, tuple(tried))
    contenders = first + instead(first, search, folds)
    for size in range(1, settings.max_effects + 1):
        doubtful = [j.error > settings.explained and j.borne < settings.form_factor * bar for j in contenders]
        contenders = [loosened(j, folds) if it else j for j, it in zip(contenders, doubtful, strict=True)]
        standing = [j for j in contenders if stands(j, base, bar, settings)]
        reach = min((j.reach for j in standing), default=np.inf)
        well = [j for j in standing if j.reach <= max(settings.explained, settings.well_explained * bar)]
        plain = min((j.error for j in well), default=np.inf)
        if plain <= settings.form_doubt or size == settings.max_effects:
            break
        nearest = min(j.reach for j in (*tried, *contenders))
        if size > 1 and not standing and nearest > settings.hopeless * bar:
            break  # nor would a third bring it there
        level = search.larger(level[: settings.parents if size == 1 else settings.parents - 1])
        contenders = [judged(fit, folds) for fit in level[: settings.contenders]]
        contenders += instead(contenders, search, folds)
        contenders += other_losses(contenders, search, folds)
        contenders += fewer(contenders, search, folds, bar)
        tried += contenders
        if well:  # by its form alone: others that need none of it stand instead
            most = min(settings.explained, settings.much_better * plain)
            others = [j for j in contenders if j.error <= most and not at_bound(j.fit)]
            standing = [j for j in others if not any(_is_within(n, j, settings) for n in standing)] or standing
            break
        if standing and not beats(min(j.error for j in contenders), reach, settings):
            break  # not even a larger set does much better: the rest is form
    if standing:
        missing = {names for j in standing for names in _plainer(j.names) if set(names) <= set(search.names)}
        missing -= {j.names for j in standing}
        standing += [loosened(judged(search.of(names), folds), folds) for names in sorted(missing)]
        standing = [j for j in twins(standing, search, folds) if not at_bound(j.fit)]
        known = {j.names for j in standing}
        standing = [j for j in standing if known.isdisjoint(_plainer(j.names)) or not hollow(j, search)]
        reach = min(j.reach for j in standing)
        standing = [j for j in standing if j.reach <= settings.explained or not beats(reach, j.reach, settings)]
        found = rivals([earned(j, base, search, folds, bar, settings) for j in standing], settings)
        if len(found) == 1 and surpassed(found[0], search, base.floors, settings):
            return Choice(base, p, (), found[0], bar, True, tuple(tried))
        drifts = [drifting(j, folds, settings) for j in found]
        if all(drifts):
            return Choice(base, p, (), found[0], bar, True, tuple(tried), drifts[0])
        found = tuple(as_added(j, search, folds) for j, drift in zip(found, drifts, strict=True) if not drift)
        return Choice(base, p, found, found[0], bar, True, tuple(tried))
    alone = min((j for j in tried if len(j.names) == 1), key=lambda j: j.error)
    drift = drifting(alone, folds, settings) if alone.floors < _NEAR * base.floors else None
    return Choice(base, p, (), min(tried, key=lambda j: j.error), bar, True, tuple(tried), drift)


def drifting(judgement: Judged, folds: tuple[Fold, ...], settings: ChoiceSettings) -> Drift | None:
    """The effect of the set that is not the same all the session."""
    runs = {run.name: run for fold in folds for run in (*fold.train, *fold.test)}
    return drift_of(judgement.free or judgement.fit, tuple(runs.values()), settings)


def as_added(judgement: Judged, search: Search, folds: tuple[Fold, ...]) -> Judged:
    """The set with the parameters that make a simulator come nearest, which knows no build-up of friction; and what
    they become when its sizes are free."""
    free = judgement.free or relaxed(judgement.fit, search.train)
    fit = prompt(judgement.fit, search.train)
    return replace(judgement if fit is judgement.fit else judged(fit, folds), free=free)


def stands(judgement: Judged, base: Judged, bar: float, settings: ChoiceSettings) -> bool:
    """Whether the set explains the held-out runs, or all but one: then its sizes must be about the same with and
    without its departures from formulas, or what they are fitted to is another effect. Nor may it miss the runs that it
    was fitted to, or explain only few of those that `base` misses."""
    if at_bound(judgement.fit) or judgement.borne > bar or explained_runs(judgement, base, settings) < settings.most:
        return False
    free = judgement.free
    if _rms(_but_worst(tempered((free or judgement.fit).residuals))) > settings.missed * bar:
        return False
    if _rms(judgement.left) <= bar or free is None:
        return True
    sizes = [
        (effect.values()[0], other.values()[0])
        for effect, other in zip(judgement.fit.effects, free.effects, strict=True)
    ]
    return all(max(abs(a), abs(b)) <= settings.same_size * min(abs(a), abs(b)) for a, b in sizes)


def explained_runs(judgement: Judged, base: Judged, settings: ChoiceSettings) -> float:
    """Part of the runs with a gap of their own, held out or fitted, in which the set halves it, or does better; 1 when
    there is none."""
    before = {**base.fit.residuals, **base.strict}
    after = {**(judgement.free or judgement.fit).residuals, **judgement.left}
    gaps = {run: _rms({run: before[run]}) for run in before if run in after}
    halved = [
        excess(_rms({run: after[run]})) < 0.5 * excess(floors)
        for run, floors in gaps.items()
        if floors > settings.plain_gap
    ]
    return float(np.mean(halved)) if halved else 1.0


def at_bound(fit: Fit) -> bool:
    """Whether a place or a width of an effect lies at the end of what it may be, a catch takes hold where it lets go,
    a slack is as narrow as can be, or a shaft throws back all that it may: it stands for something else; or whether an
    effect has no size, and stands for nothing."""
    if any(_is_nothing(effect) for effect in fit.effects) or _may_be_a_spring(fit):
        return True
    for r, x in zip(fit.theory.ranges(), fit.theta, strict=True):
        if r.owner == SHAFT and x > (1 - _SPRINGY) * r.upper:
            return True
        if (r.owner, r.name) == ("backlash", "width") and x < (1 + _NARROW) * r.lower:
            return True
        spec = EFFECTS[r.owner].parameters().get(r.name) if r.owner in EFFECTS else None
        if spec is None or spec.revolute_unit not in ("rad", "1") or EFFECTS[r.owner].acts != "force":
            continue
        place, edge = r.lower < 0, _EDGE if spec.revolute_unit == "rad" else _CAPTURE
        if x > r.upper - edge * (r.upper - r.lower) or (place and x < r.lower + _EDGE * (r.upper - r.lower)):
            return True
    return False


def _may_be_a_spring(fit: Fit) -> bool:
    """Whether stops throw a driven part back no more than its drive would behind a shaft without losses: an elastic
    drive, which is in no library."""
    stops = [e for e in fit.effects if e.acts == "stop"]
    if not stops or not any(e.acts in ("inertia", "slack") for e in fit.effects):
        return False
    speed = fit.theory.problem.speed
    back = max(abs(float(e.rebound(speed))) for e in stops)
    return back < Reader(fit.theory).behind(fit.theta, fit.effects) * speed


def _is_nothing(effect: Effect) -> bool:
    """Whether a force or a friction has no size."""
    specs = effect.parameters()
    forces = {name for name, spec in specs.items() if spec.revolute_unit == "N*m" or spec.prismatic_unit == "N"}
    return effect.acts in ("force", "drive") and not any(getattr(effect, name) for name in {next(iter(specs)), *forces})


def hollow(judgement: Judged, search: Search) -> bool:
    """Whether a general effect of the set is but a plainer one when dry friction is there at once, as simulators have
    it: what it adds stood for how friction builds up."""
    fit = prompt(judgement.fit, search.train)
    return any(e.rise < _RISE * e.level for e in fit.effects if isinstance(e, StribeckFriction))


def surpassed(judgement: Judged, search: Search, gap: float, settings: ChoiceSettings) -> bool:
    """Whether a force without a name explains much that the set leaves, its sizes free, of all runs that it was fitted
    to but the one that is met worst, or one of every four where an effect catches or throws back, and leaves more on a
    hair: then the name is not right."""
    least = max(settings.nameless, settings.nameless_part * gap)
    if judgement.fit.level <= np.hypot(1.0, least):
        return False
    free = relaxed(judgement.fit, search.train)
    sudden = any(is_sudden(cls) or cls.acts in ("slack", "inertia") for cls in free.theory.classes)
    kept = _but_worst(free.residuals, len(free.residuals) // _RUNS if sudden else 1)
    weights = steady(kept)
    left = _rms({run: r * np.sqrt(weights[run]) for run, r in kept.items()})
    runs = tuple(run for run in search.train if run.name in kept)
    return bool(left**2 - ceiling(free, runs, weights) ** 2 > least**2)


def instead(contenders: list[Judged], search: Search, folds: tuple[Fold, ...]) -> list[Judged]:
    """What sets at a bound become: with a spring in the place of a wide notch, single ones with a plainer effect."""
    known, found = {j.names for j in contenders}, []
    for j in contenders:
        if at_bound(j.fit):
            own = _plainer(j.names) if len(j.names) == 1 else []
            plain = {names for names in own if set(names) <= set(search.names)} - known
            known |= plain
            found += [*alike.narrowed(search, j.fit), *(search.of(names) for names in sorted(plain))]
    return [judged(fit, folds) for fit in found]


def other_losses(contenders: list[Judged], search: Search, folds: tuple[Fold, ...]) -> list[Judged]:
    """What the nearest set becomes with damping for another loss, or drag for damping, unless that is known."""
    best, known = min(contenders, key=lambda j: j.error), {j.names for j in contenders}
    return [judged(fit, folds) for fit in alike.losses(search, best.fit) if fit.theory.names not in known]


def fewer(contenders: list[Judged], search: Search, folds: tuple[Fold, ...], bar: float) -> list[Judged]:
    """The nearest set without each of its members, where that fits far better than it did when it was begun from less:
    what helped the search there need not be there."""
    best = min(contenders, key=lambda j: j.error)
    found = []
    for name in best.names if best.borne <= bar else ():
        before = search.fits.get(tuple(n for n in best.names if n != name))
        fit = search.without(best.fit, name)
        if before is not None and fit.cost < _ANEW * before.cost:
            found.append(judged(fit, folds))
    return found


def twins(standing: list[Judged], search: Search, folds: tuple[Fold, ...]) -> list[Judged]:
    """The standing sets and what differs from them by an effect's twin, or by a gauge, judged by the same measure; of
    twins that both stand the worse one is begun anew from the other."""
    found = {j.names: j for j in standing}
    for j in standing:
        for fit in (*alike.twins(search, j.fit), *alike.turned(search, j.fit), *alike.lighter(search, j.fit)):
            known = found.get(fit.theory.names)
            if known is None or fit.cost < known.fit.cost - 1.0:
                other = judged(fit, folds)
                found[other.names] = other if j.loose is None else loosened(other, folds)
    return list(found.values())


def earned(
    judgement: Judged, base: Judged, search: Search, folds: tuple[Fold, ...], bar: float, settings: ChoiceSettings
) -> Judged:
    """The set without the members that do not earn their places: the rest, fitted from here, predicts about as well."""
    for name in judgement.names if len(judgement.names) > 1 else ():
        smaller = loosened(judged(search.without(judgement.fit, name), folds), folds)
        about = stands(smaller, base, max(bar, settings.rival * judgement.borne), settings)
        well = smaller.reach <= settings.explained
        if about and (well or not beats(judgement.error, smaller.reach, settings)):
            return earned(smaller, base, search, folds, bar, settings)
    return judgement


def excess(floors: float) -> float:
    """What of an error, in floors, is more than noise."""
    return float(np.sqrt(max(floors**2 - 1.0, 0.0)))


def beats(floors: float, others: float, settings: ChoiceSettings) -> bool:
    """Whether an error, in floors, is much less than another's, both beyond noise."""
    return excess(floors) < settings.much_better * excess(others)


def _is_within(smaller: Judged, larger: Judged, settings: ChoiceSettings) -> bool:
    """Whether the larger set, or what it becomes in special cases, is but the smaller one with more beside it, and not
    even much better than its form."""
    more = smaller.reach > settings.explained and beats(larger.error, smaller.reach, settings)
    within = any(set(smaller.names) <= set(names) for names in (larger.names, *_plainer(larger.names)))
    return within and not more


def judged(fit: Fit, folds: tuple[Fold, ...]) -> Judged:
    """How the set predicts what it was not fitted to."""
    residuals: dict[str, Array] = {}
    for fold in folds:
        residuals.update(foretold(_refitted(fit, fold), fold.test).residuals)
    return Judged(fit, residuals)


def loosened(judgement: Judged, folds: tuple[Fold, ...]) -> Judged:
    """The same with the sizes of the effects free within the form tolerance."""
    residuals: dict[str, Array] = {}
    free = [relaxed(_refitted(judgement.fit, fold), fold.train) for fold in folds]
    for fold, fit in zip(folds, free, strict=True):
        residuals.update(foretold(fit, fold.test).residuals)
    return Judged(judgement.fit, judgement.strict, residuals, free[0])


def _refitted(fit: Fit, fold: Fold) -> Fit:
    if set(fit.starts) == {run.name for run in fold.train}:
        return fit
    return fitted(fit.theory, fold.train, fit.theta, fit.starts, iterations=8)


def p_value(base: Judged, best: Judged, tried: int) -> float:
    """That noise alone makes the best of `tried` sets, chosen on other runs, predict held-out runs so much better.

    For a fixed change of the prediction, noise of standard deviation 1 makes the sum of squares fall by x or more with
    a probability of at most that of a normal number above sqrt(x) (the likelihood ratio of two points); times the
    number of sets. x is counted in what the better set leaves, and in independent readings.
    """
    before, after = tempered(base.strict), tempered(best.strict)
    fall = sum(float((before[run] ** 2).sum() - (after[run] ** 2).sum()) for run in before)
    return float(min(1.0, tried * norm.sf(np.sqrt(max(fall, 0.0) / unit_of(after)))))


def rivals(standing: list[Judged], settings: ChoiceSettings) -> tuple[Judged, ...]:
    """Those that the held-out runs do not tell from the best, the best first; a general effect yields to a plainer.

    What another set of the same size beats on the runs that both were fitted to is none of them, when that is much, or
    the other does better on held-out runs, too.
    """
    order = sorted(standing, key=lambda j: j.error)

    def beaten(j: Judged) -> bool:
        own = [o for o in order if len(o.names) == len(j.names) and beats(o.learned, j.learned, settings)]
        both = any(
            _plain_load(o) != _plain_load(j)
            and o.error <= j.error
            and j.learned**2 - o.learned**2 > settings.rival_power
            for o in own
        )
        return bool(own and j.learned > settings.explained) or both

    order = [j for j in order if not beaten(j)]
    plainer = [j for j in order if j.names in _plainer(order[0].names) and j.error < settings.rival * order[0].error]
    best = (plainer or order)[0]
    least = tempered(best.strict)
    unit = unit_of(least)

    def near(j: Judged) -> bool:
        own = tempered(j.strict)
        more = sum(float((own[run] ** 2).sum() - (least[run] ** 2).sum()) for run in least)
        if more < settings.rival_sum * unit:
            return True
        # what the formulas of twins leave they leave alike: only where they differ counts, or what the fitted runs say
        own_kind = j is best or _plain_load(j) != _plain_load(best)
        return j.error < settings.rival * best.error and (own_kind or j.learned <= best.learned)

    first: dict[tuple[str, ...], Judged] = {}
    for j in order:
        first.setdefault(j.names, j)
    kept = [j for j in first.values() if near(j)]
    fewest = min(len(j.names) for j in kept)
    kept = [j for j in kept if len(j.names) == fewest]
    names = {j.names for j in kept}
    plain = [j for j in kept if not any(p in names for p in _plainer(j.names))]
    return tuple(plain)


def _plain_load(judgement: Judged) -> set[str]:
    """The names, with the one of twins in the place of the other, and of what it becomes in a special case."""
    return {"coulomb_friction" if PLAINER.get(name, name) in alike.TWINS else name for name in judgement.names}


def _plainer(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The sets that this one becomes in special cases."""
    found = []
    for name in names:
        if name in PLAINER:
            rest = {n for n in names if n != name}
            found.append(tuple(sorted({*rest, PLAINER[name]})))
    return found


def _but_worst(residuals: dict[str, Array], out: int = 1) -> dict[str, Array]:
    """Residuals by run without those of the `out` runs that are met worst, of four or more."""
    runs = sorted(residuals.items(), key=lambda item: float(np.mean(item[1] ** 2)))
    return dict(runs[: len(runs) - out] if len(runs) >= _RUNS else runs)


def _rms(residuals: dict[str, Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(list(residuals.values())) ** 2)))
