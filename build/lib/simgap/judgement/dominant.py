"""What dominates where more is missing than any set of effects explains: a name in part.

Real machines leave a remainder above their sensor's noise. All sets are judged by one score, the log predictive density
of the runs kept back (`predictive`). Beside them in the table stand forces without a name, which the nearest set has
been given to first order: of position, of velocity, friction of two levels. The smallest set within one standard error
of the best stands in part, unless such a force takes a good part of the gap: then that dominates, and has no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from freeart21.se3 import Array
from simgap.fitting import alike
from simgap.fitting.fit import Fit, placed
from simgap.fitting.guess import Linear
from simgap.fitting.search import Search
from simgap.judgement.choose import Choice
from simgap.judgement.judge import Fold, Judged, excess, judged, rms
from simgap.judgement.objections import bounded, drifting
from simgap.judgement.predictive import Score, error_of, lead, smallest, stretch_densities
from simgap.settings import ChoiceSettings

_STRETCHES = 8
"""Of the runs kept back, at least, whose scores are paired: fewer tell no standard error."""
_GAINS = (0.5, 2.0)
"""Of what a drive is told to give, between which a gain may be named beside a remainder: a drive that is off by more is
another drive, or a loss holds it."""
_LEAST = 0.02
"""Part of the largest loss's force, up to the top speed, that another has at least: less dominates nothing. Not
measured."""
_END = 0.01
"""Part of a range that counts as its end."""
_NAMELESS = {
    "position": ("detent", "return_spring"),
    "velocity": ("coulomb_friction", "quadratic_drag", "stribeck_friction", "viscous_damping"),
    "direction": ("return_spring",),
}
"""Forces without a name, by the effects whose columns span them; of direction: a constant push, which with friction is
friction of two levels."""
_LOSSES = ("coulomb_friction", "load_friction", "quadratic_drag", "stribeck_friction", "viscous_damping")
"""What takes energy: no force of position does."""
_DRY = ("coulomb_friction", "load_friction", "stribeck_friction")
_EVERYWHERE = (*_LOSSES, "armature", "encoder_offset", "gravity_offset", "actuator_gain")
"""What every machine has, more or less. What only some have (a notch, a catch, a spring, play, a stop) is hardly told
from forces of position without a name where a remainder is left, so that is no name in part."""


@dataclass(frozen=True)
class Rest:
    """A force without a name beside a set, before runs kept back."""

    kind: str
    """position, velocity or direction."""
    floors: float
    """That are left with it."""


def in_part(choice: Choice, search: Search, folds: tuple[Fold, ...], settings: ChoiceSettings) -> Choice:
    """The choice with what dominates in the place of nothing, or of names that leave many floors; as it was where
    nothing dominates."""
    said = choice.explaining
    if not choice.gap or (said and not doubtful(said[0], settings)):
        return choice
    known = {j.names: j for j in (*choice.tried, *said)}
    for fit in search.losses():
        if fit.theory.names not in known:
            known[fit.theory.names] = judged(fit, folds)
    stood = {j.names for j in said if not _at_end(j.fit)}
    able = [j for j in known.values() if j.names in stood or _may_dominate(j, choice.base, settings)]
    odd = bool(said) and said[0].floors <= settings.many_floors
    if not able:
        return choice if odd else replace(choice, explaining=())
    of = {j.names: j for j in able}
    scores = {names: scored(j, folds) for names, j in of.items()}
    near = smallest(list(scores.values()))
    if odd:  # a number that hardly any machine has stands where it does better than losses
        ahead, error = lead(scored(said[0], folds), max(scores.values(), key=lambda s: s.total))
        if ahead > error:
            return choice
    if choice.refused:  # what explained the runs stands for something without a name: only what does better may stand
        ahead, error = lead(max(scores.values(), key=lambda s: s.total), scored(choice.best, folds))
        if ahead <= error:
            return choice
    best = of[near[0].names]
    for fit in alike.twins(search, best.fit):  # the same where the load on the bearing stays as it is
        other = judged(fit, folds)
        if _may_dominate(other, choice.base, settings):
            of[other.names], scores[other.names] = other, scored(other, folds)
    near = smallest([s for s in scores.values() if len(s.names) == len(best.names)])
    standing = [of[score.names] for score in near]
    others = [j for j in known.values() if not set(j.names) <= set(_EVERYWHERE)]
    odd_ones = [j for j in known.values() if _at_end(j.fit)]
    standing = [j for j in standing if not _beaten(j, scores[j.names], odd_ones, folds)]
    standing = [j for j in standing if not takes_much(_nameless(j, others, folds), j, choice.base, settings)]
    standing = [j for j in standing if drifting(j, folds, settings) is None]
    if not standing:
        return replace(choice, explaining=())
    return replace(choice, explaining=tuple(standing), best=standing[0], in_part=True)


def _nameless(judgement: Judged, others: Sequence[Judged], folds: tuple[Fold, ...]) -> tuple[Rest, ...]:
    """What stands against a set: forces without a name beside it, and sets without it, of what only some machines
    have."""
    own = _plainly(judgement.names)
    without = [Rest(" with ".join(j.names), j.floors) for j in others if not own <= _plainly(j.names)]
    return (*rests(judgement, folds), *without)


def _beaten(judgement: Judged, score: Score, odd: Sequence[Judged], folds: tuple[Fold, ...]) -> bool:
    """Whether a set with a number that no machine has, and without this one, does better: it stands for what has no
    name, and that is more of what is missing than this one is."""
    own = _plainly(judgement.names)
    rivals = [scored(j, folds) for j in odd if not own <= _plainly(j.names)]
    return any(ahead > error for ahead, error in (lead(rival, score) for rival in rivals))


def _plainly(names: Sequence[str]) -> set[str]:
    """The names, all dry friction being one."""
    return {"coulomb_friction" if name in _DRY else name for name in names}


def doubtful(judgement: Judged, settings: ChoiceSettings) -> bool:
    """Whether a set leaves many floors, or has a number that no machine has."""
    return judgement.floors > settings.many_floors or _at_end(judgement.fit)


def _may_dominate(judgement: Judged, base: Judged, settings: ChoiceSettings) -> bool:
    """Whether a set has a loss, one dry friction at most, no number at its end, and halves the gap in most of the runs
    kept back."""
    names = set(judgement.names)
    if not names & set(_LOSSES) or names - set(_EVERYWHERE) or bounded(judgement) or _at_end(judgement.fit):
        return False
    if len(names & set(_DRY)) > 1:  # one contact has one law of friction
        return False
    if _slight(judgement.fit):
        return False
    gaps = [(rms({run: r}), rms({run: base.strict[run]})) for run, r in judgement.strict.items()]
    return float(np.mean([excess(now) < settings.dominant * excess(was) for now, was in gaps])) > 0.5


def _slight(fit: Fit) -> bool:
    """Whether a loss of the set takes next to no force beside another."""
    problem = fit.theory.problem
    speed = problem.speed * np.linspace(0.05, 1.0, 20)
    middle = np.full(len(speed), problem.reference[1])
    forces = [
        float(np.sqrt(np.mean((e.law(middle, -speed, problem.load, 1.0, *e.values()) * np.ones(len(speed))) ** 2)))
        for e in fit.effects
        if e.name in _LOSSES
    ]
    return min(forces) < _LEAST * max(forces)


def _at_end(fit: Fit) -> bool:
    """Whether a number of an effect lies at the end of what it may be."""
    for cls in fit.theory.classes:
        own = [(r, x) for r, x in zip(fit.theory.ranges(), fit.theta, strict=True) if r.owner == cls.name]
        if any(x > r.upper - _END * (r.upper - r.lower) for r, x in own):
            return True
        if any(r.lower < 0 and x < r.lower + _END * (r.upper - r.lower) for r, x in own):
            return True
        if cls.name == "actuator_gain" and not _GAINS[0] < own[0][1] < _GAINS[1]:
            return True
    return False


def scored(judgement: Judged, folds: tuple[Fold, ...]) -> Score:
    """The set's log predictive density of what was kept back; and, where some runs are kept back for good, of those
    that were fitted, less half the logarithm of their readings for each number (Schwarz 1978): what is kept back may
    be of one kind of motion, which tells little of the other."""
    fitted_to = [
        run for run in {r.name: r for f in folds for r in f.train}.values() if run.name in judgement.fit.starts
    ]
    back = [run for fold in folds for run in fold.test]
    own, seen = (judgement.fit.residuals, fitted_to) if fitted_to else (judgement.strict, back)
    error = error_of(own, seen)
    parts = [stretch_densities(judgement.strict[r.name], r, error, -(-_STRETCHES // len(back))) for r in back]
    if len(folds) == 1:
        count, p = -(-_STRETCHES // len(seen)), len(judgement.fit.theta)
        price = 0.5 * p * np.log(sum(len(run.q) for run in seen)) / (count * len(seen))
        parts += [stretch_densities(own[run.name], run, error, count) - price for run in seen]
    return Score(judgement.names, np.concatenate(parts), error)


def rests(judgement: Judged, folds: tuple[Fold, ...]) -> tuple[Rest, ...]:
    """What forces without a name leave beside the set, fitted to first order where it was fitted, before what was kept
    back; only where some runs are kept back from all fits."""
    if len(folds) != 1 or set(judgement.fit.starts) != {run.name for run in folds[0].train}:
        return ()
    fit, (train, test) = judgement.fit, (folds[0].train, folds[0].test)
    there = placed(fit, test, judgement.starts or None)
    first, second = Linear(fit, train), Linear(there, test)
    found = []
    for kind, names in _NAMELESS.items():
        new = [name for name in names if name not in fit.theory.names]
        columns = [
            np.concatenate([at.parameters, *(_columns(at, name, kind) for name in new)]) for at in (first, second)
        ]
        left = second.freed - _told(columns[0], first.freed) @ columns[1]
        found.append(Rest(kind, float(np.sqrt(np.mean(left**2)))))
    return tuple(found)


def _columns(at: Linear, name: str, kind: str) -> Array:
    """(m, N) of an effect at all its places; of a spring's at two of them the difference, a push."""
    rows = at.columns(name)
    return rows[-1:] - rows[:1] if kind == "direction" else rows


def _told(columns: Array, told: Array) -> Array:
    """(m,) sizes of columns (m, N) in what is left (N,), each of them no larger than all that is left."""
    size = np.maximum(np.linalg.norm(columns, axis=1), 1e-9)
    scaled = columns / size[:, None]
    ridge = len(columns) / max(float(told @ told), 1e-12)
    return np.asarray(np.linalg.solve(scaled @ scaled.T + ridge * np.eye(len(columns)), scaled @ told) / size)


def takes_much(found: Sequence[Rest], judgement: Judged, base: Judged, settings: ChoiceSettings) -> bool:
    """Whether a force without a name does away with most of what the set leaves, and that is a good part of the gap."""
    here = judgement.floors
    return any(
        excess(rest.floors) < settings.much_better * excess(here)
        and here**2 - rest.floors**2 > (settings.nameless_dominates * base.floors) ** 2
        for rest in found
    )
