"""Model selection: which set of effects explains the runs.

Every set found by the search is scored by its log predictive density of runs that it was not fitted to (`hypotheses`,
`predictive`), with model error allowed. The smallest sets within one standard error of the best are accepted; several
of them are rivals. A set that leaves almost no residual is the answer. Real machines leave more than sensor noise: then
the dominant effects are named in part, of those that every machine has. Otherwise nothing is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from freeart21.effects import EFFECTS
from simgap.fit.fit import Fit
from simgap.fit.force_search import ForceSearch
from simgap.fit.search import Search, drop_least_presliding, drop_presliding, simplify
from simgap.select.discrepancy import KINDS, Discrepancy, find_discrepancies
from simgap.select.hypotheses import Hypothesis, evaluate_set, evaluate_with_model_error, excess
from simgap.select.predictive import score_difference, select_smallest
from simgap.select.split import Fold
from simgap.settings import JudgementSettings
from simgap.verdict import GAP_THRESHOLD

_SETS_PER_SIZE = 5
"""Sets of each size that are evaluated with model error, the most probable ones. In 59 cases more changed one verdict.
"""
_BOUND_SHARE = 0.01
"""Share of a parameter's range that counts as its bound."""


@dataclass(frozen=True)
class Choice:
    """Result of the model selection."""

    base: Hypothesis
    """No effect missing, only the asset's own parameters off."""
    best: Hypothesis
    """The most probable set, accepted or not."""
    accepted: tuple[Hypothesis, ...] = ()
    """Accepted sets, the most probable first; empty without a gap, or when nothing may be named."""
    has_gap: bool = False
    in_part: bool = False
    """Whether the accepted sets are only the dominant effects and leave a residual without a name."""
    discrepancies: tuple[Discrepancy, ...] = ()
    """Nonparametric discrepancies of the accepted set, or of the best one."""
    table: tuple[Hypothesis, ...] = field(default=(), repr=False)


def choose_hypotheses(search: Search | ForceSearch, folds: tuple[Fold, ...], settings: JudgementSettings) -> Choice:
    """The smallest sets that explain the gap, else the dominant effects, else none."""
    base = evaluate_set(search.base(), folds)
    if not search.is_promising():
        return Choice(base, base, table=(base,))
    base = evaluate_set(base.fit, folds, base)
    fits = [drop_least_presliding(fit, search.train) for fit in search.explore()]
    table = [base, *(evaluate_set(fit, folds, base) for fit in fits)]
    best = max(table, key=lambda h: h.score.total)
    if not _has_gap(base, best, settings):
        return Choice(base, best, table=tuple(table))
    evaluated = _allow_model_error([h for h in table if not _has_shape(h)], search, folds, base)
    whole = smallest_sets(h for h in evaluated if explains_gap(h, base, settings))
    # a subset that leaves too much, but is about as probable: then passing the threshold is chance
    whole = [h for h in whole if not any({*o.names} < {*h.names} and not _is_ahead(h, o) for o in evaluated)]
    part = [] if whole else _find_dominant(table, base, settings)
    if not whole and not part:  # free shapes come last
        table += [evaluate_set(fit, folds, base) for fit in search.fit_shapes()]
        best = max(table, key=lambda h: h.score.total)
        evaluated += (shapes := _allow_model_error([h for h in table if _has_shape(h)], search, folds, base))
        whole = smallest_sets(h for h in shapes if explains_gap(h, base, settings))
    accepted = [fit_for_simulator(h, search, folds, base) for h in whole or part]
    nearest = (whole or part or [best])[0]
    kinds = KINDS if nearest.rms > GAP_THRESHOLD else ("session",)  # noise leaves the others nothing
    discrepancies = find_discrepancies(nearest, folds, kinds)
    if any(_drifts(n) for n in discrepancies):
        accepted = []
    return Choice(
        base,
        best,
        tuple(accepted),
        has_gap=True,
        in_part=bool(accepted) and not whole,
        discrepancies=discrepancies,
        table=tuple(table) if not whole else tuple(evaluated),
    )


def _drifts(rival: Discrepancy) -> bool:
    """Whether the size of an effect changes over the session, significantly and by more than real ones deviate from
    its formula."""
    much = any(abs(change) > max(EFFECTS[name].model_error) for name, change in rival.changes.items())
    return rival.kind == "session" and rival.gain > rival.error and much


def _has_gap(base: Hypothesis, best: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set is more probable than the asset alone and removes more than coarse time stamps explain, or most
    runs are far above the noise."""
    ahead, error = score_difference(best.score, base.score)
    taken = float(np.sqrt(max(base.rms**2 - best.rms**2, 0.0)))
    clear = [rms > settings.plain_gap for rms in base.rms_by_run.values()]
    return (ahead > error and taken >= settings.least_gap) or sum(clear) >= (1 - settings.met) * len(clear)


def _has_shape(hypothesis: Hypothesis) -> bool:
    """Whether an effect of the set is a free shape (`Effect.complexity` > 1)."""
    return any(EFFECTS[name].complexity > 1 for name in hypothesis.names)


def _allow_model_error(
    table: Sequence[Hypothesis], search: Search | ForceSearch, folds: tuple[Fold, ...], base: Hypothesis
) -> list[Hypothesis]:
    """The most probable sets of each size, with model error allowed."""
    order = sorted((h for h in table if h.names), key=lambda h: -h.score.total)
    sizes = sorted({len(h.names) for h in order})
    found = [h for size in sizes for h in [o for o in order if len(o.names) == size][:_SETS_PER_SIZE]]
    return found if search.is_overtime else [evaluate_with_model_error(h, folds, base) for h in found]


def smallest_sets(table: Iterable[Hypothesis]) -> list[Hypothesis]:
    """The smallest sets within one standard error of the best, the most probable first, without those that are another
    of them in a special case (`Effect.reduces_to`)."""
    of = {h.names: h for h in table}
    near = [score.names for score in select_smallest([h.score for h in of.values()])] if of else []
    return [of[names] for names in near if not any(special in near for special in _special_cases(names))]


def _special_cases(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    special = [(name, EFFECTS[name].reduces_to) for name in names]
    return [tuple(sorted({*names, less} - {name})) for name, less in special if less]


def explains_gap(hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set leaves almost none of the gap of `base`."""
    before, after = base.rms_by_run, hypothesis.rms_by_run
    most = {run: np.hypot(GAP_THRESHOLD, settings.explained_part * excess(before[run])) for run in after}
    return _in_most_runs(hypothesis, base, settings.met, lambda run: after[run] <= min(most[run], settings.most))


def _find_dominant(table: Sequence[Hypothesis], base: Hypothesis, settings: JudgementSettings) -> list[Hypothesis]:
    """The smallest sets that may dominate. A set with a parameter at a bound, which no machine has, excludes those that
    are clearly less probable: then something else is at work."""
    odd = [h for h in table if h.names and is_at_bound(h.fit)]
    candidates = [h for h in table if may_dominate(h, base, settings)]
    best = max(candidates, key=lambda h: h.score.total, default=None)
    near = [h for h in candidates if best is not None and not _is_ahead(best, h)]
    return smallest_sets(h for h in near if not any(_is_ahead(o, h) for o in odd if not {*h.names} <= {*o.names}))


def _is_ahead(other: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether another set is more probable by more than a standard error."""
    ahead, error = score_difference(other.score, hypothesis.score)
    return ahead > error


def may_dominate(hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set consists of effects that every machine has, a loss among them, of plausible sizes, and halves the
    gap."""
    classes = [EFFECTS[name] for name in hypothesis.names]
    if not any(cls.dissipates for cls in classes) or not all(cls.common for cls in classes):
        return False
    if not all(effect.is_plausible() for effect in hypothesis.fit.effects):
        return False
    after, before = hypothesis.rms_by_run, base.rms_by_run
    return _in_most_runs(
        hypothesis, base, 0.5, lambda run: excess(after[run]) < settings.dominant * excess(before[run])
    )


def _in_most_runs(hypothesis: Hypothesis, base: Hypothesis, share: float, holds: Callable[[str], bool]) -> bool:
    """Whether something holds in this share of the runs that show a gap, and in half of the test runs among these."""
    shown = [run for run in hypothesis.rms_by_run if base.rms_by_run[run] > GAP_THRESHOLD]
    tested = [run for run in shown if run in hypothesis.test_residuals]
    return sum(map(holds, shown)) >= share * len(shown) and sum(map(holds, tested)) >= 0.5 * len(tested)


def is_at_bound(fit: Fit) -> bool:
    """Whether a parameter of an effect is at its bound. 0, where the effect vanishes, does not count."""
    numbers = [(r, x) for r, x in zip(fit.model.ranges(), fit.theta, strict=True) if r.owner in EFFECTS]
    numbers = [(r, x) for r, x in numbers if EFFECTS[r.owner].acts != "stop"]  # full restitution is no bound
    return any(
        x > r.upper - _BOUND_SHARE * (r.upper - r.lower)
        or (r.lower < 0 and x < r.lower + _BOUND_SHARE * (r.upper - r.lower))
        for r, x in numbers
    )


def fit_for_simulator(
    hypothesis: Hypothesis, search: Search | ForceSearch, folds: tuple[Fold, ...], base: Hypothesis
) -> Hypothesis:
    """The set refitted as a simulator has it, without presliding, and reduced where its parameters are of a special
    case."""
    fit = simplify(drop_presliding(hypothesis.fit, search.train), search.train)
    if fit is hypothesis.fit:
        return hypothesis
    added = evaluate_set(fit, folds, base)
    return evaluate_with_model_error(added, folds, base) if hypothesis.has_model_error else added
