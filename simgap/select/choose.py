"""Which set of effects stands: one table, one score.

Every set that the search came to is judged by the log predictive density of runs that it was not fitted to
(`hypotheses`, `predictive`), its effects departing from their formulas as real ones do. The smallest within one
standard error of the best stand; those of them are rivals that no run tells apart. A set that leaves next to nothing is
the answer. Real machines leave a remainder above their sensor's noise: then what dominates is named in part, of what
every machine has. Where neither is so, nothing is named.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from freeart21.effects import EFFECTS
from simgap.fit.fit import Fit
from simgap.fit.force_search import ForceSearch
from simgap.fit.guess import idle
from simgap.fit.search import Search, plain, prompt
from simgap.measure.data import FitRun
from simgap.models.surrogate import is_local
from simgap.select.hypotheses import Hypothesis, departing, excess, judged
from simgap.select.nameless import Nameless, beside
from simgap.select.predictive import lead, smallest
from simgap.select.split import Fold
from simgap.settings import JudgementSettings
from simgap.verdict import SHOWS

_OF_A_SIZE = 5
"""Sets of each size that may depart from their formulas, the most probable ones: of 59 cases that were tried more
changed one verdict."""
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
    fits = [fit if search.late else at_once(fit, search.train) for fit in search.explored()]
    fits = [fit for fit in fits if not idle(fit, search.train, base.fit.level)]
    table = [base, *(judged(fit, folds, base) for fit in fits)]
    best = max(table, key=lambda h: h.score.total)
    if not _has_gap(base, best, settings):
        return Choice(base, best, table=tuple(table))
    able = _best_of_each_size([h for h in table if not _has_shape(h)])
    real = [h if search.late else departing(h, folds, base) for h in sorted(able, key=lambda h: -h.score.total)]
    able = [h for h in real if named_whole(h, base, settings, table)]
    able = [h for h in able if not any(_mends(h, part) for part in able)]
    whole = [h for h in nearest(able) if not _is_less_enough(h, real)]
    part = [] if whole else _dominating(table, base, settings)
    if not whole and not part:  # what has a formula, and what every machine has, come first
        shaped = [fit for fit in search.shaped() if not idle(fit, search.train, base.fit.level)]
        table += [judged(fit, folds, base) for fit in shaped]
        best = max(table, key=lambda h: h.score.total)
        real += [h if search.late else departing(h, folds, base) for h in table if _has_shape(h)]
        whole = nearest(h for h in real if _has_shape(h) and named_whole(h, base, settings))
    standing = [(h, as_added(h, search, folds, base)) for h in whole or part]
    standing = [(h, added) for h, added in standing if whole or may_dominate(added, base, settings)]
    nameless = beside(standing[0][0] if standing else best, folds)
    if any(_drifts(n, settings) for n in nameless):
        standing = []
    return Choice(
        base,
        best,
        tuple(added for _, added in standing),
        gap=True,
        in_part=bool(standing) and not whole,
        nameless=nameless,
        table=tuple(table) if not whole else tuple(real),
    )


def at_once(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit, or the same set with dry friction that is there at once, where that is nearer than friction that builds
    up over the least way that is tried: a joint that sticks and is pushed to and fro shows even that way."""
    return min((fit, prompt(fit, runs)), key=lambda f: f.cost)


def _drifts(rival: Nameless, settings: JudgementSettings) -> bool:
    """Whether the size of an effect is no constant: it clearly changes over the session, and by much."""
    much = any(abs(change) > settings.drift for change in rival.changes.values())
    return rival.kind == "session" and rival.ahead > rival.error and much


def _has_gap(base: Hypothesis, best: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set makes the runs more probable than the asset does, and takes more of what is left than coarse time
    stamps may; or most runs leave far more than noise."""
    ahead, error = lead(best.score, base.score)
    taken = float(np.sqrt(max(base.floors**2 - best.floors**2, 0.0)))
    plain = [floors > settings.plain_gap for floors in base.by_run.values()]
    return (ahead > error and taken >= settings.least_gap) or sum(plain) >= (1 - settings.met) * len(plain)


def _has_shape(hypothesis: Hypothesis) -> bool:
    """Whether an effect of the set may be of any shape."""
    return any(EFFECTS[name].counts > 1 for name in hypothesis.names)


def _best_of_each_size(table: Sequence[Hypothesis]) -> list[Hypothesis]:
    order = sorted((h for h in table if h.names), key=lambda h: -h.score.total)
    sizes = sorted({len(h.names) for h in order})
    return [h for size in sizes for h in [o for o in order if len(o.names) == size][:_OF_A_SIZE]]


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


def named_whole(
    hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings, table: Sequence[Hypothesis] = ()
) -> bool:
    """Whether a set leaves next to nothing of what `base` does, or what its formulas are off by, in all runs that show
    a gap but one of four, which may hang on a hair, and in half of those that choose; and none of its numbers is at its
    bound, where it stands for something else. What an effect's formula is off by is a part of what it takes beside the
    others, by the sets of `table`."""
    if at_end(hypothesis.fit):
        return False
    before, after = base.by_run, hypothesis.by_run
    shown = [run for run in after if before[run] > SHOWS] or list(after)
    off = {run: _form_error(hypothesis, run, base, table) for run in shown}
    parts = {run: np.hypot(settings.explained_part * excess(before[run]), off[run]) for run in shown}
    most = {run: min(np.hypot(SHOWS, parts[run]), settings.most) for run in shown}
    met = {run: after[run] <= most[run] for run in shown}
    chose = [met[run] for run in shown if run in hypothesis.left]
    return sum(met.values()) >= settings.met * len(met) and sum(chose) >= 0.5 * len(chose)


def _form_error(hypothesis: Hypothesis, run: str, base: Hypothesis, table: Sequence[Hypothesis]) -> float:
    """Floors of a run by which the formulas of a set are off (`Effect.form_error`)."""
    of, off = {h.names: h for h in table}, 0.0
    for name in hypothesis.names:
        rest = of.get(tuple(n for n in hypothesis.names if n != name), base)
        off = float(np.hypot(off, EFFECTS[name].form_error * excess(rest.by_run[run])))
    return off


def _is_less_enough(hypothesis: Hypothesis, table: Sequence[Hypothesis]) -> bool:
    """Whether a part of a set, which leaves too much for a name, is about as probable as all of it: that what all of it
    leaves just passes then hangs on a hair."""
    fewer = [h for h in table if h.score.size < hypothesis.score.size and _within(h, hypothesis)]
    return any(not _is_ahead(hypothesis, h) for h in fewer)


def _mends(hypothesis: Hypothesis, part: Hypothesis) -> bool:
    """Whether all that a set has beside a part of it are forces at a place, as is one of the part whose formula is off
    by itself (`Effect.form_error`)."""
    more = {*hypothesis.names} - {*part.names}
    off = any(EFFECTS[name].form_error > 0 for name in part.names)
    return off and bool(more) and {*part.names} < {*hypothesis.names} and all(is_local(EFFECTS[name]) for name in more)


def _within(hypothesis: Hypothesis, other: Hypothesis) -> bool:
    """Whether another set has all that a set has, dry friction being one, and what becomes a plainer effect that."""
    return _plain_names(hypothesis.names) <= _plain_names(other.names)


def _plain_names(names: tuple[str, ...]) -> set[str]:
    return {"dry friction" if _is_dry(name) else EFFECTS[name].becomes or name for name in names}


def _dominating(table: Sequence[Hypothesis], base: Hypothesis, settings: JudgementSettings) -> list[Hypothesis]:
    """The smallest sets that may dominate, but where a set with a number at its bound, which no machine has, is clearly
    more probable than they: then something else is at work."""
    able = [h for h in table if may_dominate(h, base, settings)]
    best = max(able, key=lambda h: h.score.total, default=None)
    near = [h for h in able if best is not None and not _is_ahead(best, h)]
    odd = [h for h in table if h.names and at_end(h.fit)]
    rivals = nearest(h for h in near if not any(_is_ahead(o, h) for o in odd if not _within(h, o)))
    return _shared(rivals, able) or rivals


def _shared(rivals: Sequence[Hypothesis], able: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The part that all rivals have, where that may itself dominate: it is sure, what they have besides is not."""
    if not rivals:
        return []
    common = set.intersection(*(_plain_names(h.names) for h in rivals))
    smaller = [h for h in able if h.score.size < rivals[0].score.size and _plain_names(h.names) == common]
    return nearest(smaller)


def _is_ahead(other: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether another set is more probable by more than a standard error."""
    ahead, error = lead(other.score, hypothesis.score)
    return ahead > error


def _is_dry(name: str) -> bool:
    """Whether an effect is a dry friction of the joint's bearing, or becomes one."""
    cls = EFFECTS[name]
    return (cls.acts == "drive" and not cls.geared) or (cls.becomes is not None and _is_dry(cls.becomes))


def may_dominate(hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set is of what every machine has, a loss and one dry friction at most among it, no number at its bound
    or beyond what is usual, and halves the gap in most of the runs that show one, and in half of those that choose."""
    classes = [EFFECTS[name] for name in hypothesis.names]
    one_friction = sum(_is_dry(name) for name in hypothesis.names) <= 1  # one contact has one law of it
    if not any(cls.dissipates for cls in classes) or not all(cls.common for cls in classes) or not one_friction:
        return False
    if at_end(hypothesis.fit) or not all(effect.is_usual() for effect in hypothesis.fit.effects):
        return False
    after, before = hypothesis.by_run, base.by_run
    halved = {run: excess(after[run]) < settings.dominant * excess(before[run]) for run in after if before[run] > SHOWS}
    chose = [halved[run] for run in halved if run in hypothesis.left]
    return sum(halved.values()) > 0.5 * len(halved) and sum(chose) >= 0.5 * len(chose)


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
    """The set with the numbers that bring a simulator nearest, which knows no build-up of friction; by its plainer name
    where these are of a special case."""
    fit = plain(prompt(hypothesis.fit, search.train), search.train)
    if fit is hypothesis.fit:
        return hypothesis
    added = judged(fit, folds, base)
    return departing(added, folds, base) if hypothesis.departing else added
