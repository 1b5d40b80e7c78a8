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
from simgap.fit.guess import has_inactive_effect
from simgap.fit.search import Search, drop_presliding, simplify
from simgap.measure.data import FitRun
from simgap.models.surrogate import is_local
from simgap.select.discrepancy import Discrepancy, find_discrepancies
from simgap.select.hypotheses import Hypothesis, evaluate_set, evaluate_with_model_error, excess
from simgap.select.predictive import score_difference, select_smallest
from simgap.select.split import Fold
from simgap.settings import JudgementSettings
from simgap.verdict import GAP_THRESHOLD

_SETS_PER_SIZE = 5
"""Sets of each size that may depart from their formulas, the most probable ones: of 59 cases that were tried more
changed one verdict."""
_BOUND_SHARE = 0.01
"""Part of a range that counts as its end."""


@dataclass(frozen=True)
class Choice:
    """What stands."""

    base: Hypothesis
    """Nothing missing but what the asset may be off by."""
    best: Hypothesis
    """The most probable set, whether it may be named or not."""
    accepted: tuple[Hypothesis, ...] = ()
    """Rivals, the most probable first; empty when there is no gap, or nothing may be named."""
    has_gap: bool = False
    in_part: bool = False
    """Whether the sets of `explaining` are but what dominates: they leave a remainder without a name."""
    discrepancies: tuple[Discrepancy, ...] = ()
    """Forces without a name beside what is named, or beside what was nearest."""
    table: tuple[Hypothesis, ...] = field(default=(), repr=False)


def choose_hypotheses(search: Search | ForceSearch, folds: tuple[Fold, ...], settings: JudgementSettings) -> Choice:
    """The smallest explanation, what dominates, or none."""
    base = evaluate_set(search.base(), folds)
    if not search.is_promising():
        return Choice(base, base, table=(base,))
    base = evaluate_set(base.fit, folds, base)
    fits = [fit if search.is_overtime else select_presliding(fit, search.train) for fit in search.explore()]
    fits = [fit for fit in fits if not has_inactive_effect(fit, search.train, base.fit.rms)]
    table = [base, *(evaluate_set(fit, folds, base) for fit in fits)]
    best = max(table, key=lambda h: h.score.total)
    if not _has_gap(base, best, settings):
        return Choice(base, best, table=tuple(table))
    candidates = _best_of_each_size([h for h in table if not _has_shape(h)])
    evaluated = [
        h if search.is_overtime else evaluate_with_model_error(h, folds, base)
        for h in sorted(candidates, key=lambda h: -h.score.total)
    ]
    candidates = [h for h in evaluated if explains_gap(h, base, settings, table)]
    candidates = [h for h in candidates if not any(_repairs_formula(h, part) for part in candidates)]
    whole = [h for h in select_irreducible(candidates) if not _is_subset_enough(h, evaluated)]
    part = [] if whole else _find_dominant(table, base, settings)
    if not whole and not part:  # what has a formula, and what every machine has, come first
        fit_shapes = [fit for fit in search.fit_shapes() if not has_inactive_effect(fit, search.train, base.fit.rms)]
        table += [evaluate_set(fit, folds, base) for fit in fit_shapes]
        best = max(table, key=lambda h: h.score.total)
        evaluated += [
            h if search.is_overtime else evaluate_with_model_error(h, folds, base) for h in table if _has_shape(h)
        ]
        whole = select_irreducible(h for h in evaluated if _has_shape(h) and explains_gap(h, base, settings))
    accepted = [(h, fit_for_simulator(h, search, folds, base)) for h in whole or part]
    accepted = [(h, added) for h, added in accepted if whole or may_dominate(added, base, settings)]
    discrepancies = find_discrepancies(accepted[0][0] if accepted else best, folds)
    if any(_drifts(n, settings) for n in discrepancies):
        accepted = []
    return Choice(
        base,
        best,
        tuple(added for _, added in accepted),
        has_gap=True,
        in_part=bool(accepted) and not whole,
        discrepancies=discrepancies,
        table=tuple(table) if not whole else tuple(evaluated),
    )


def select_presliding(fit: Fit, runs: tuple[FitRun, ...]) -> Fit:
    """The fit, or the same set with dry friction that is there at once, where that is nearer than friction that builds
    up over the least way that is tried: a joint that sticks and is pushed to and fro shows even that way."""
    return min((fit, drop_presliding(fit, runs)), key=lambda f: f.cost)


def _drifts(rival: Discrepancy, settings: JudgementSettings) -> bool:
    """Whether the size of an effect is no constant: it clearly changes over the session, and by much."""
    much = any(abs(change) > settings.drift for change in rival.changes.values())
    return rival.kind == "session" and rival.gain > rival.error and much


def _has_gap(base: Hypothesis, best: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set makes the runs more probable than the asset does, and takes more of what is left than coarse time
    stamps may; or most runs leave far more than noise."""
    ahead, error = score_difference(best.score, base.score)
    taken = float(np.sqrt(max(base.rms**2 - best.rms**2, 0.0)))
    simplify = [floors > settings.plain_gap for floors in base.rms_by_run.values()]
    return (ahead > error and taken >= settings.least_gap) or sum(simplify) >= (1 - settings.met) * len(simplify)


def _has_shape(hypothesis: Hypothesis) -> bool:
    """Whether an effect of the set may be of any shape."""
    return any(EFFECTS[name].complexity > 1 for name in hypothesis.names)


def _best_of_each_size(table: Sequence[Hypothesis]) -> list[Hypothesis]:
    order = sorted((h for h in table if h.names), key=lambda h: -h.score.total)
    sizes = sorted({len(h.names) for h in order})
    return [h for size in sizes for h in [o for o in order if len(o.names) == size][:_SETS_PER_SIZE]]


def select_irreducible(table: Iterable[Hypothesis]) -> list[Hypothesis]:
    """The smallest sets within one standard error of the best, the most probable first; none that becomes another of
    them in a special case."""
    of = {h.names: h for h in table}
    near = [of[score.names] for score in select_smallest([h.score for h in of.values()])] if of else []
    names = {h.names for h in near}
    return [h for h in near if not any(p in names for p in reduced_sets(h.names))]


def reduced_sets(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The sets that this one becomes in special cases."""
    special = [(name, EFFECTS[name].reduces_to) for name in names]
    return [tuple(sorted({*names, less} - {name})) for name, less in special if less]


def explains_gap(
    hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings, table: Sequence[Hypothesis] = ()
) -> bool:
    """Whether a set leaves next to nothing of what `base` does, or what its formulas are off by, in all runs that show
    a gap but one of four, which may hang on a hair, and in half of those that choose; and none of its numbers is at its
    bound, where it stands for something else. What an effect's formula is off by is a part of what it takes beside the
    others, by the sets of `table`."""
    if is_at_bound(hypothesis.fit):
        return False
    before, after = base.rms_by_run, hypothesis.rms_by_run
    shown = [run for run in after if before[run] > GAP_THRESHOLD] or list(after)
    off = {run: _form_error(hypothesis, run, base, table) for run in shown}
    parts = {run: np.hypot(settings.explained_part * excess(before[run]), off[run]) for run in shown}
    most = {run: min(np.hypot(GAP_THRESHOLD, parts[run]), settings.most) for run in shown}
    met = {run: after[run] <= most[run] for run in shown}
    chose = [met[run] for run in shown if run in hypothesis.test_residuals]
    return sum(met.values()) >= settings.met * len(met) and sum(chose) >= 0.5 * len(chose)


def _form_error(hypothesis: Hypothesis, run: str, base: Hypothesis, table: Sequence[Hypothesis]) -> float:
    """Floors of a run by which the formulas of a set are off (`Effect.form_error`)."""
    of, off = {h.names: h for h in table}, 0.0
    for name in hypothesis.names:
        rest = of.get(tuple(n for n in hypothesis.names if n != name), base)
        off = float(np.hypot(off, EFFECTS[name].form_error * excess(rest.rms_by_run[run])))
    return off


def _is_subset_enough(hypothesis: Hypothesis, table: Sequence[Hypothesis]) -> bool:
    """Whether a part of a set, which leaves too much for a name, is about as probable as all of it: that what all of it
    leaves just passes then hangs on a hair."""
    fewer = [h for h in table if h.score.size < hypothesis.score.size and _is_contained(h, hypothesis)]
    return any(not _is_ahead(hypothesis, h) for h in fewer)


def _repairs_formula(hypothesis: Hypothesis, part: Hypothesis) -> bool:
    """Whether all that a set has beside a part of it are forces at a place, as is one of the part whose formula is off
    by itself (`Effect.form_error`)."""
    more = {*hypothesis.names} - {*part.names}
    off = any(EFFECTS[name].form_error > 0 for name in part.names)
    return off and bool(more) and {*part.names} < {*hypothesis.names} and all(is_local(EFFECTS[name]) for name in more)


def _is_contained(hypothesis: Hypothesis, other: Hypothesis) -> bool:
    """Whether another set has all that a set has, dry friction being one, and what becomes a plainer effect that."""
    return _reduced_names(hypothesis.names) <= _reduced_names(other.names)


def _reduced_names(names: tuple[str, ...]) -> set[str]:
    return {"dry friction" if _is_dry(name) else EFFECTS[name].reduces_to or name for name in names}


def _find_dominant(table: Sequence[Hypothesis], base: Hypothesis, settings: JudgementSettings) -> list[Hypothesis]:
    """The smallest sets that may dominate, but where a set with a number at its bound, which no machine has, is clearly
    more probable than they: then something else is at work."""
    candidates = [h for h in table if may_dominate(h, base, settings)]
    best = max(candidates, key=lambda h: h.score.total, default=None)
    near = [h for h in candidates if best is not None and not _is_ahead(best, h)]
    odd = [h for h in table if h.names and is_at_bound(h.fit)]
    rivals = select_irreducible(h for h in near if not any(_is_ahead(o, h) for o in odd if not _is_contained(h, o)))
    return _common_part(rivals, candidates) or rivals


def _common_part(rivals: Sequence[Hypothesis], candidates: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The part that all rivals have, where that may itself dominate: it is sure, what they have besides is not."""
    if not rivals:
        return []
    common = set.intersection(*(_reduced_names(h.names) for h in rivals))
    smaller = [h for h in candidates if h.score.size < rivals[0].score.size and _reduced_names(h.names) == common]
    return select_irreducible(smaller)


def _is_ahead(other: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether another set is more probable by more than a standard error."""
    ahead, error = score_difference(other.score, hypothesis.score)
    return ahead > error


def _is_dry(name: str) -> bool:
    """Whether an effect is a dry friction of the joint's bearing, or becomes one."""
    cls = EFFECTS[name]
    return (cls.acts == "drive" and not cls.geared) or (cls.reduces_to is not None and _is_dry(cls.reduces_to))


def may_dominate(hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set is of what every machine has, a loss and one dry friction at most among it, no number at its bound
    or beyond what is usual, and halves the gap in most of the runs that show one, and in half of those that choose."""
    classes = [EFFECTS[name] for name in hypothesis.names]
    one_friction = sum(_is_dry(name) for name in hypothesis.names) <= 1  # one contact has one law of it
    if not any(cls.dissipates for cls in classes) or not all(cls.common for cls in classes) or not one_friction:
        return False
    if is_at_bound(hypothesis.fit) or not all(effect.is_plausible() for effect in hypothesis.fit.effects):
        return False
    after, before = hypothesis.rms_by_run, base.rms_by_run
    halved = {
        run: excess(after[run]) < settings.dominant * excess(before[run])
        for run in after
        if before[run] > GAP_THRESHOLD
    }
    chose = [halved[run] for run in halved if run in hypothesis.test_residuals]
    return sum(halved.values()) > 0.5 * len(halved) and sum(chose) >= 0.5 * len(chose)


def is_at_bound(fit: Fit) -> bool:
    """Whether a number of an effect is at the end of what it may be; 0, where the effect is none, is no such end."""
    numbers = [(r, x) for r, x in zip(fit.model.ranges(), fit.theta, strict=True) if r.owner in EFFECTS]
    numbers = [(r, x) for r, x in numbers if EFFECTS[r.owner].acts != "stop"]  # all that a stop gives back is no bound
    return any(
        x > r.upper - _BOUND_SHARE * (r.upper - r.lower)
        or (r.lower < 0 and x < r.lower + _BOUND_SHARE * (r.upper - r.lower))
        for r, x in numbers
    )


def fit_for_simulator(
    hypothesis: Hypothesis, search: Search | ForceSearch, folds: tuple[Fold, ...], base: Hypothesis
) -> Hypothesis:
    """The set with the numbers that bring a simulator nearest, which knows no build-up of friction; by its plainer name
    where these are of a special case."""
    fit = simplify(drop_presliding(hypothesis.fit, search.train), search.train)
    if fit is hypothesis.fit:
        return hypothesis
    added = evaluate_set(fit, folds, base)
    return evaluate_with_model_error(added, folds, base) if hypothesis.has_model_error else added
