"""What speaks against an explanation, however little it leaves: a number at its bound, runs that it does not help, a
force without a name that does better, a size that changes over the session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from freeart21.effects import EFFECTS, Effect
from freeart21.effects.detent import Detent
from freeart21.effects.end_stop_bounce import EndStopBounce
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.stribeck_friction import StribeckFriction
from simgap.fitting.fit import Fit, steady, tempered
from simgap.fitting.search import Search, beside, is_local, is_sudden, prompt, relaxed
from simgap.fitting.theory import HOLDING, SHAFT, Reader
from simgap.judgement.ceiling import ceiling
from simgap.judgement.drift import Drift, drift_of
from simgap.judgement.intervals import is_force, with_intervals
from simgap.judgement.judge import RUNS, Fold, Judged, beats, but_worst, excess, judged, loosened, rms
from simgap.settings import ChoiceSettings

_EDGE = 0.02
"""Part of a range that counts as its end."""
_WAYS, _NO_WORSE = 2, 1.1
"""Ways in which an asset may not be off by all that it may; times its sum of squares that a fit beside one that is not
may have."""
_SPRINGY = 0.05
"""The same of what a shaft gives back."""
_NARROW = 0.5
"""Part by which a slack must be wider than the narrowest that can be told from a shaft that twists."""
_CAPTURE = 0.1
"""The same of a catch's way."""
_FLANK = 2 * np.exp(-1.0)
"""Of a notch: the steepest way out of it, times its width over its largest force."""
_ALIKE = 1 / 3
"""Part of a spring's largest pull, wherever the part goes, above which its least one is about alike."""
_FEW = 2
"""Runs of which none may be missed."""
_RISE, _SURE_RISE = 0.1, 0.5
"""Parts of the level of dry friction below which a rise at rest is none; and where it may be none."""


def stands(judgement: Judged, base: Judged, bar: float, settings: ChoiceSettings) -> bool:
    """Whether the set explains the held-out runs, or all but one: then its sizes must be about the same with and
    without its departures from formulas, or what they are fitted to is another effect. Nor may it miss the runs that it
    was fitted to, or explain only few of those that `base` misses."""
    if bounded(judgement) or judgement.borne > bar or not helps(judgement, base, settings):
        return False
    free = judgement.free
    if rms(but_worst(tempered((free or judgement.fit).residuals))) > settings.missed * bar:
        return False
    if rms(judgement.left) <= bar or free is None:
        return True
    sizes = [
        (effect.values()[0], other.values()[0])
        for effect, other in zip(judgement.fit.effects, free.effects, strict=True)
    ]
    return all(max(abs(a), abs(b)) <= settings.same_size * min(abs(a), abs(b)) for a, b in sizes)


def helps(judgement: Judged, base: Judged, settings: ChoiceSettings) -> bool:
    """Whether the set halves the gap, or does better, in all runs that have a plain one of their own, held out or
    fitted, but a few: one of three or more may hang on a hair. But hardly one of each kind that has
    nearly all of the gap."""
    fitted = base.fit.residuals.keys()
    before = {**base.fit.residuals, **base.strict}
    after = {**(judgement.free or judgement.fit).residuals, **judgement.left}
    gaps = {run: rms({run: before[run]}) for run in before if run in after}
    wide = {run: floors for run, floors in gaps.items() if floors > settings.plain_gap}
    left = {run: excess(rms({run: after[run]})) / excess(floors) for run, floors in wide.items()}
    missed = sum(part >= 0.5 for part in left.values())
    kinds = (base.strict.keys(), fitted - base.strict.keys())
    if all(_misses_most({run: gaps[run] for run in own & gaps.keys()}, left, settings) for own in kinds):
        return False
    return missed <= max(len(wide) > _FEW, int(settings.spared * len(wide)))


def _misses_most(gaps: dict[str, float], left: dict[str, float], settings: ChoiceSettings) -> bool:
    """Whether much is left (parts of gaps) of a run whose gap, in floors, is many times that of all the others."""
    if len(gaps) < _FEW:
        return False
    run = max(gaps, key=lambda run: gaps[run])
    others = float(np.sqrt(np.mean([floors**2 for name, floors in gaps.items() if name != run])))
    return gaps[run] > settings.wild * others and left.get(run, 0.0) > settings.widest


def bounded(judgement: Judged) -> bool:
    """Whether the set is one at a bound; where a drive is in it, with its sizes free if they were freed: flanks that do
    not give way, and shafts that do not twist, leave it to what comes back from limits. Nor may a freed shaft twist all
    that it may."""
    told = zip(judgement.free.theory.ranges(), judgement.free.theta, strict=True) if judgement.free else ()
    if any((r.owner, r.name) == ("armature form", "give") and x > (1 - _SPRINGY) * r.upper for r, x in told):
        return True
    drive = any(effect.acts in ("slack", "inertia") for effect in judgement.fit.effects)
    return at_bound(judgement.free if drive and judgement.free else judgement.fit)


def springs_back(fit: Fit) -> bool:
    """Whether a shaft throws back all that it may, or swings as slowly: it stands for a spring."""
    told = zip(fit.theory.ranges(), fit.theta, strict=True)
    return any(r.owner == SHAFT and x > (1 - _SPRINGY) * r.upper for r, x in told)


def at_bound(fit: Fit) -> bool:
    """Whether a place or a width of an effect lies at the end of what it may be, a catch takes hold where it lets go,
    a slack is as narrow as can be, or a shaft throws back all that it may: it stands for something else; or whether an
    effect has no size, and stands for nothing."""
    if any(_is_nothing(effect) for effect in fit.effects) or _may_be_a_spring(fit) or springs_back(fit):
        return True
    for r, x in zip(fit.theory.ranges(), fit.theta, strict=True):
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
    names = list(effect.parameters())
    sizes = {names[0], *(name for name in names if is_force(effect, name))}
    return effect.acts in ("force", "drive") and not any(getattr(effect, name) for name in sizes)


def may_be_else(judgement: Judged, search: Search, folds: tuple[Fold, ...], settings: ChoiceSettings) -> bool:
    """Whether something that has no name may be all that the set stands for."""
    if strained(judgement, search):
        return True
    if len(judgement.names) > 1 and (may_be_nothing(judgement) or may_be_one_way(judgement)):
        return True
    return may_be_a_shaft(judgement, search) or may_be_bent(judgement, search, folds, settings)


def strained(judgement: Judged, search: Search) -> bool:
    """Whether the set needs the asset to be off by all that it may, in two ways or more, and fits worse beside one that
    is off by half of that: what strains it so pulls otherwise than the set does."""
    fit = judgement.fit
    ends = [set(_at_ends(own)) for own in (fit, judgement.free or fit)]
    shared = ends[0] & ends[1]
    if len(shared) < _WAYS:
        return False
    halfway = fit.theta.copy()
    for i, r in enumerate(fit.theory.ranges()):
        if r.owner == "asset" and r.name in shared:
            halfway[i] = 0.5 * (halfway[i] + r.neutral)
    again = beside(fit, replace(fit, theta=halfway), search.train)
    return again.cost > _NO_WORSE * fit.cost


def _at_ends(fit: Fit) -> list[str]:
    """Of the numbers by which the asset is off, those at an end of what they may be."""
    told = [(r, x) for r, x in zip(fit.theory.ranges(), fit.theta, strict=True) if r.owner == "asset"]
    told = [(r, x) for r, x in told if r.name != HOLDING]  # inputs are held, or go on straight: either is usual
    return [r.name for r, x in told if min(x - r.lower, r.upper - x) < _EDGE * (r.upper - r.lower)]


def may_be_nothing(judgement: Judged) -> bool:
    """Whether a notch or a catch of the set is as good as none: it but bends what another force does, as a notch does
    whose spring pulls out of it everywhere."""
    effects = judgement.fit.effects
    spring = sum(e.stiffness for e in effects if isinstance(e, ReturnSpring))
    if any(isinstance(e, Detent) and _FLANK * e.peak / e.width < spring for e in effects):
        return True
    return any(
        is_local(type(named.effect)) and named.low[next(iter(named.low))] <= 0 for named in with_intervals(judgement)
    )


def may_be_a_shaft(judgement: Judged, search: Search) -> bool:
    """Whether what stops throw back, slow as fast, may be a drive's inertia behind its shaft that is taken for the
    part's own: of an asset whose inertia is known to a tenth that is a sixth or less of the speed."""
    fit = judgement.fit
    driven = any(np.any(run.inputs.effort) or np.isfinite(run.inputs.command).any() for run in search.train)
    back = [e.restitution for e in fit.effects if isinstance(e, EndStopBounce)]
    return driven and bool(back) and max(back) < Reader(fit.theory).behind(fit.theta, fit.effects)


def may_be_bent(judgement: Judged, search: Search, folds: tuple[Fold, ...], settings: ChoiceSettings) -> bool:
    """Whether a lone spring that is bent by far more than springs are does about as well as a larger set of which one
    member, too, is a force of position: such a force, which has no name, may be all that is there."""
    if len(judgement.names) == 1 or not {"return_spring", "gravity_offset"} & set(judgement.names):
        return False
    if "return_spring" not in search.names:
        return False
    spring = loosened(judged(search.of(("return_spring",)), folds), folds, bent=True)
    return not beats(judgement.reach, spring.reach, settings)


def may_be_one_way(judgement: Judged) -> bool:
    """Whether a spring beside dry friction pulls one way wherever the part goes, and about alike: friction that differs
    by direction does so, too."""
    problem, effects = judgement.fit.theory.problem, judgement.fit.effects
    pulls = [[e.force(q, 0.0) for q in (problem.q_low, problem.q_high)] for e in effects if isinstance(e, ReturnSpring)]
    dry = any(e.acts == "drive" for e in effects)
    return dry and any(low * high > 0 and min(low / high, high / low) > _ALIKE for low, high in pulls)


def hollow(judgement: Judged, search: Search) -> bool:
    """Whether a general effect of the set is but a plainer one when dry friction is there at once, as simulators have
    it: what it adds stood for how friction builds up."""
    fit = prompt(judgement.fit, search.train)
    known = {named.effect.name: named.low for named in with_intervals(judgement)}
    rises = [(e.rise, e.level, known[e.name]["rise"]) for e in fit.effects if isinstance(e, StribeckFriction)]
    return any(rise < (_RISE if low > 0 else _SURE_RISE) * level for rise, level, low in rises)


def surpassed(judgement: Judged, search: Search, base: Judged, settings: ChoiceSettings) -> bool:
    """Whether a force without a name explains much of what the set leaves, its sizes free: then the name is not right.

    Asked of all runs that it was fitted to but the one that is met worst, or one of every four where an effect catches
    or throws back, since more of those hang on a hair. Much is a part of the gap, or a larger part of the gap without
    the run that is widest, whichever is less.
    """
    usual = min(settings.nameless_part * base.floors, settings.nameless_usual * base.borne)
    least = max(settings.nameless, usual)
    if judgement.fit.level <= np.hypot(1.0, least):
        return False
    free = relaxed(judgement.fit, search.train)
    sudden = any(is_sudden(cls) or cls.acts in ("slack", "inertia") for cls in free.theory.classes)
    kept = but_worst(free.residuals, len(free.residuals) // RUNS if sudden else 1)
    weights = steady(kept)
    left = rms({run: r * np.sqrt(weights[run]) for run, r in kept.items()})
    runs = tuple(run for run in search.train if run.name in kept)
    return bool(left**2 - ceiling(free, runs, weights) ** 2 > least**2)


def drifting(judgement: Judged, folds: tuple[Fold, ...], settings: ChoiceSettings) -> Drift | None:
    """The effect of the set that is not the same all the session."""
    runs = {run.name: run for fold in folds for run in (*fold.train, *fold.test)}
    return drift_of(judgement.free or judgement.fit, tuple(runs.values()), settings)
