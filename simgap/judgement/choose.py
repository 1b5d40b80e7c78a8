"""Which set of effects stands: one table, one score, and what is asked of a name.

Every set that the search came to is judged by the log predictive density of runs that it was not fitted to
(`hypotheses`, `predictive`). The smallest within one standard error of the best stand, those of them being rivals that
no run tells apart. A set that leaves next to nothing is the answer. Real machines leave a remainder above their
sensor's noise: then a set is named in part, if it is made of what every machine has, does most of what can be done and
no force without a name (`nameless`) takes a good part of the gap beside it. Where neither is so, nothing is named.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from freeart21.effects import EFFECTS, Effect
from simgap.fitting.fit import Fit
from simgap.fitting.force_search import ForceSearch
from simgap.fitting.guess import idle
from simgap.fitting.search import Search, prompt
from simgap.fitting.theory import departures_of
from simgap.judgement.hypotheses import Hypothesis, departing, excess, judged
from simgap.judgement.nameless import Nameless, beside
from simgap.judgement.predictive import lead, smallest
from simgap.judgement.split import Fold
from simgap.settings import JudgementSettings
from simgap.verdict import SHOWS

_SMALLER = 3
"""Smaller sets beside which forces without a name are tried: the most probable ones."""
_END = 0.01
"""Part of a range that counts as its end."""


@dataclass(frozen=True)
class Choice:
    """What stands."""

    base: Hypothesis
    """Nothing missing but what the asset may be off by."""
    best: Hypothesis
    """The most probable set, whether it may be named or not."""
    explaining: tuple[Hypothesis, ...] = ()
    """Rivals, the most probable first; empty when there is no gap, or nothing may be named."""
    gap: bool = False
    in_part: bool = False
    """Whether the sets of `explaining` are but what dominates: they leave a remainder without a name."""
    nameless: tuple[Nameless, ...] = ()
    """Forces without a name beside what is named, or beside what was nearest."""
    table: tuple[Hypothesis, ...] = field(default=(), repr=False)


def chosen(search: Search | ForceSearch, folds: tuple[Fold, ...], settings: JudgementSettings) -> Choice:
    """The smallest explanation, what dominates, or none."""
    base = judged(search.base(), folds)
    if not search.promising():
        return Choice(base, base, table=(base,))
    base = judged(base.fit, folds, base)
    able = [fit for fit in search.explored() if not idle(fit, search.train, base.fit.level)]
    table = [base, *(judged(fit, folds, base) for fit in able)]
    best = max(table, key=lambda h: h.score.total)
    ahead, error = lead(best.score, base.score)
    closed = float(np.sqrt(max(base.floors**2 - best.floors**2, 0.0)))
    plain = [floors > settings.plain_gap for floors in base.by_run.values()]
    if (ahead <= error or closed < settings.least_gap) and sum(plain) < (1 - settings.met) * len(plain):
        return Choice(base, best, table=tuple(table))
    found = Choice(base, best, gap=True, table=tuple(table))
    real = [departing(h, folds, base) for h in table]
    standing = nearest(h for h in real if h.names and named_whole(h, base, settings))
    told = {h.names: beside(h, folds) for h in standing}
    whole = [h for h in standing if not any(refutes(n, base, settings) for n in told[h.names])]
    whole = [h for h in whole if not _plainer_without_name(h, real, folds) and not _smaller_as_probable(h, real)]
    if whole:
        added = tuple(as_added(h, search, folds, base) for h in whole)
        return replace(found, explaining=added, nameless=told[whole[0].names], table=tuple(real))
    part = [(h, as_added(h, search, folds, base)) for h in dominating(table, base, folds, settings)]
    part = [(h, added) for h, added in part if _may_dominate(added, base, settings)]  # as a simulator has it, too
    if part:
        added = tuple(there for _, there in part)
        return replace(found, explaining=added, in_part=True, nameless=beside(part[0][0], folds))
    near = standing[0] if standing else best
    return replace(found, nameless=told.get(near.names) or beside(near, folds))


def nearest(table: Iterable[Hypothesis]) -> list[Hypothesis]:
    """The smallest sets within one standard error of the best, the most probable first; none that becomes another of
    them in a special case."""
    of = {h.names: h for h in table}
    near = [of[score.names] for score in smallest([h.score for h in of.values()])] if of else []
    names = {h.names for h in near}
    return [h for h in near if not any(p in names for p in plainer(h.names))]


def plainer(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The sets that this one becomes in special cases."""
    special = [(name, EFFECTS[name].becomes) for name in names]
    return [tuple(sorted({*names, less} - {name})) for name, less in special if less]


def named_whole(hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set leaves next to nothing of what `base` does, in all runs that show a gap but one of four, which may
    hang on a hair, and in half of those that choose; and none of its numbers is at its bound, where it stands for
    something else."""
    if at_end(hypothesis.fit):
        return False
    before, after = base.by_run, hypothesis.by_run
    depart = all(departures_of(EFFECTS[name]) for name in hypothesis.names)
    part = settings.explained_part if depart else settings.formula_part
    shown = [run for run in after if before[run] > SHOWS] or list(after)
    met = {
        run: after[run] <= min(np.hypot(settings.explained, part * excess(before[run])), settings.most) for run in shown
    }
    chose = [met[run] for run in shown if run in hypothesis.left]
    return sum(met.values()) >= settings.met * len(met) and sum(chose) >= 0.5 * len(chose)


def refutes(rival: Nameless, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a force without a name is more probable beside a set than the set alone, and takes a good part of the gap
    in choosing runs; or sizes that change over the session are so by more than a standard error, and change by much."""
    if rival.kind == "session":
        much = any(abs(change) > settings.drift for change in rival.changes.values())
        return rival.ahead > rival.error and much
    return rival.ahead > 0 and rival.taken > max(settings.least_gap, settings.good_part * excess(base.floors))


def _plainer_without_name(hypothesis: Hypothesis, table: Sequence[Hypothesis], folds: tuple[Fold, ...]) -> bool:
    """Whether one effect less and a force without a name of fewer numbers is about as probable as a set: the smaller
    one stands then, and what the set calls by a name has none."""
    fewer = [h for h in table if h.names and len(h.names) < len(hypothesis.names) and _within(h, hypothesis)]
    for smaller in sorted(fewer, key=lambda h: -h.score.total)[:_SMALLER]:
        for rival in beside(smaller, folds, len(hypothesis.fit.theta) - len(smaller.fit.theta) - 1):
            ahead, error = lead(hypothesis.score, replace(smaller.score, parts=smaller.score.parts + rival.more))
            if ahead <= error:
                return True
    return False


def _smaller_as_probable(hypothesis: Hypothesis, table: Sequence[Hypothesis]) -> bool:
    """Whether a part of a set, which leaves too much for a name, is about as probable as all of it: that what all of it
    leaves just passes then hangs on a hair."""
    fewer = [h for h in table if h.names and len(h.names) < len(hypothesis.names) and _within(h, hypothesis)]
    return any(not _beats(hypothesis, h) for h in fewer)


def dominating(
    table: Sequence[Hypothesis], base: Hypothesis, folds: tuple[Fold, ...], settings: JudgementSettings
) -> list[Hypothesis]:
    """The smallest sets of what every machine has within one standard error of the best of them, by their formulas: how
    effects depart from these would take what has no name. None of which what has no name, a set with a number that no
    machine has, or one of what only some machines have, does away with most of what it leaves."""
    able = [h for h in table if _may_dominate(h, base, settings)]
    best = max(able, key=lambda h: h.score.total, default=None)
    near = [h for h in able if best is not None and not _beats(best, h)]
    others = [h for h in table if h.names and not _common(h.names)]
    odd = [h for h in table if at_end(h.fit) and not _unmoved(h.fit)]
    standing = [h for h in near if not any(_beats(o, h) for o in odd if not _within(h, o))]
    standing = [h for h in standing if not any(_takes_much(o, h, base, settings) for o in others if not _within(h, o))]
    return nearest(h for h in standing if not any(overtakes(n, h, base, settings) for n in beside(h, folds)))


def overtakes(rival: Nameless, hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a force without a name speaks against a set that is named in part: it takes a good part of what the set
    does, and is no mere remainder; or sizes change over the session."""
    if rival.kind == "session":
        return refutes(rival, base, settings)
    taken = float(np.sqrt(max(base.floors**2 - hypothesis.floors**2, 0.0)))
    return rival.ahead > 0 and rival.taken > max(settings.least_gap, settings.rival_part * taken)


def _may_dominate(hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set is of what every machine has, a loss and one dry friction at most among it, none of them slight, no
    number at its bound, and halves the gap in most of the runs that show one, and in half of those that choose."""
    names, fit = hypothesis.names, hypothesis.fit
    dry = sum(_is_dry(name) for name in names)  # one contact has one law of friction
    if not any(EFFECTS[name].dissipates for name in names) or not _common(names) or dry > 1:
        return False
    if at_end(fit) or _slight(fit, settings) or not _usual_gain(fit, settings):
        return False
    after, before = hypothesis.by_run, base.by_run
    halved = {run: excess(after[run]) < settings.dominant * excess(before[run]) for run in after if before[run] > SHOWS}
    chose = [halved[run] for run in halved if run in hypothesis.left]
    return sum(halved.values()) > 0.5 * len(halved) and sum(chose) >= 0.5 * len(chose)


def _common(names: tuple[str, ...]) -> bool:
    return all(EFFECTS[name].common for name in names)


def _within(hypothesis: Hypothesis, other: Hypothesis) -> bool:
    """Whether another set has all that a set has, dry friction being one, and what becomes a plainer effect that."""
    return _plainly(hypothesis.names) <= _plainly(other.names)


def _plainly(names: tuple[str, ...]) -> set[str]:
    return {"dry friction" if _is_dry(name) else EFFECTS[name].becomes or name for name in names}


def _is_dry(name: str) -> bool:
    """Whether an effect is a dry friction of the joint's bearing."""
    return EFFECTS[name].acts == "drive" and not EFFECTS[name].geared


def _beats(other: Hypothesis, hypothesis: Hypothesis) -> bool:
    ahead, error = lead(other.score, hypothesis.score)
    return ahead > error


def _takes_much(other: Hypothesis, hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether another set does away with most of what a set leaves, and that is a good part of the gap."""
    less = float(np.sqrt(max(hypothesis.floors**2 - other.floors**2, 0.0)))
    much = excess(other.floors) < settings.much_better * excess(hypothesis.floors)
    return much and less > max(settings.least_gap, settings.good_part * excess(base.floors))


def _unmoved(fit: Fit) -> bool:
    """Whether the set has all the inertia that it may: what no force moves goes on as it began, and explains
    nothing."""
    told = [(r, x) for r, x in zip(fit.theory.ranges(), fit.theta, strict=True) if r.owner in EFFECTS]
    return any(EFFECTS[r.owner].acts == "inertia" and x > (1 - _END) * r.upper for r, x in told)


def _slight(fit: Fit, settings: JudgementSettings) -> bool:
    """Whether a loss of the set takes next to no force beside another, up to the top speed."""
    problem = fit.theory.problem
    speed = problem.speed * np.linspace(0.05, 1.0, 20)
    middle = np.full(len(speed), problem.reference[1])

    def size(loss: Effect) -> float:
        force = loss.law(middle, -speed, problem.presses(type(loss)), 1.0, *loss.values()) * np.ones(len(speed))
        return float(np.sqrt(np.mean(force**2)))

    forces = [size(effect) for effect in fit.effects if effect.dissipates]
    return min(forces) < settings.slight * max(forces)


def _usual_gain(fit: Fit, settings: JudgementSettings) -> bool:
    """Whether a drive that is named gives about what it is told: beyond that it is another drive, or a loss holds
    it."""
    gains = [effect.gain() for effect in fit.effects if effect.name == "actuator_gain"]
    return all(1 / settings.most_gain < gain < settings.most_gain for gain in gains)


def at_end(fit: Fit) -> bool:
    """Whether a number of an effect is at the end of what it may be; 0, where the effect is none, is no such end."""
    told = [(r, x) for r, x in zip(fit.theory.ranges(), fit.theta, strict=True) if r.owner in EFFECTS]
    told = [(r, x) for r, x in told if EFFECTS[r.owner].acts != "stop"]  # all that a stop gives back is no bound
    return any(
        x > r.upper - _END * (r.upper - r.lower) or (r.lower < 0 and x < r.lower + _END * (r.upper - r.lower))
        for r, x in told
    )


def as_added(
    hypothesis: Hypothesis, search: Search | ForceSearch, folds: tuple[Fold, ...], base: Hypothesis
) -> Hypothesis:
    """The set with the numbers that bring a simulator nearest, which knows no build-up of friction."""
    fit = prompt(hypothesis.fit, search.train)
    if fit is hypothesis.fit:
        return hypothesis
    return departing(judged(fit, folds, base), folds, base) if hypothesis.departing else judged(fit, folds, base)
