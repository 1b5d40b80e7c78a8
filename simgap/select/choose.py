"""Model selection: which set of effects explains the runs.

Every set found by the search is scored by its log predictive density of runs that it was not fitted to (`hypotheses`,
`predictive`), with model error allowed. The smallest sets within one standard error of the best are accepted; several
of them are rivals. A set that leaves almost no residual is the answer. Real machines leave more than sensor noise: then
the dominant effects are named in part, of those that every machine has. Otherwise nothing is named.
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
from simgap.select.discrepancy import Discrepancy, find_discrepancies
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
    if not whole and not part:  # free shapes come last
        shapes = [fit for fit in search.fit_shapes() if not has_inactive_effect(fit, search.train, base.fit.rms)]
        table += [evaluate_set(fit, folds, base) for fit in shapes]
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
    """The fit, or the same set with friction without presliding where that fits better. A joint that sticks while it is
    pushed back and forth shows even the smallest presliding travel of the model."""
    return min((fit, drop_presliding(fit, runs)), key=lambda f: f.cost)


def _drifts(rival: Discrepancy, settings: JudgementSettings) -> bool:
    """Whether the size of an effect changes over the session, significantly and by much."""
    much = any(abs(change) > settings.drift for change in rival.changes.values())
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


def _best_of_each_size(table: Sequence[Hypothesis]) -> list[Hypothesis]:
    order = sorted((h for h in table if h.names), key=lambda h: -h.score.total)
    sizes = sorted({len(h.names) for h in order})
    return [h for size in sizes for h in [o for o in order if len(o.names) == size][:_SETS_PER_SIZE]]


def select_irreducible(table: Iterable[Hypothesis]) -> list[Hypothesis]:
    """The smallest sets within one standard error of the best, the most probable first, without those that reduce to
    another of them."""
    of = {h.names: h for h in table}
    near = [of[score.names] for score in select_smallest([h.score for h in of.values()])] if of else []
    names = {h.names for h in near}
    return [h for h in near if not any(p in names for p in reduced_sets(h.names))]


def reduced_sets(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The sets that this one reduces to in special cases."""
    special = [(name, EFFECTS[name].reduces_to) for name in names]
    return [tuple(sorted({*names, less} - {name})) for name, less in special if less]


def explains_gap(
    hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings, table: Sequence[Hypothesis] = ()
) -> bool:
    """Whether a set leaves almost none of the gap of `base` in three of four runs that show one and in half of the test
    runs among these, with no parameter at a bound. What an effect's own form error (`Effect.form_error`) leaves of its
    contribution, by the sets of `table`, is allowed."""
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
    """Normalised RMS of a run that the form errors of a set explain (`Effect.form_error`)."""
    of, off = {h.names: h for h in table}, 0.0
    for name in hypothesis.names:
        rest = of.get(tuple(n for n in hypothesis.names if n != name), base)
        off = float(np.hypot(off, EFFECTS[name].form_error * excess(rest.rms_by_run[run])))
    return off


def _is_subset_enough(hypothesis: Hypothesis, table: Sequence[Hypothesis]) -> bool:
    """Whether a subset, which leaves too much to be accepted, is about as probable: then passing the threshold is
    chance."""
    fewer = [h for h in table if h.score.size < hypothesis.score.size and _is_contained(h, hypothesis)]
    return any(not _is_ahead(hypothesis, h) for h in fewer)


def _repairs_formula(hypothesis: Hypothesis, part: Hypothesis) -> bool:
    """Whether a set adds only local forces to a part of it that has a form error: they correct that formula."""
    more = {*hypothesis.names} - {*part.names}
    off = any(EFFECTS[name].form_error > 0 for name in part.names)
    return off and bool(more) and {*part.names} < {*hypothesis.names} and all(EFFECTS[name].is_local() for name in more)


def _is_contained(hypothesis: Hypothesis, other: Hypothesis) -> bool:
    """Whether another set contains this one, up to reductions; all dry friction counts as one."""
    return _reduced_names(hypothesis.names) <= _reduced_names(other.names)


def _reduced_names(names: tuple[str, ...]) -> set[str]:
    return {"dry friction" if _is_dry(name) else EFFECTS[name].reduces_to or name for name in names}


def _find_dominant(table: Sequence[Hypothesis], base: Hypothesis, settings: JudgementSettings) -> list[Hypothesis]:
    """The smallest sets that may dominate. A set with a parameter at a bound, which no machine has, excludes those that
    are clearly less probable: then something else is at work."""
    candidates = [h for h in table if may_dominate(h, base, settings)]
    best = max(candidates, key=lambda h: h.score.total, default=None)
    near = [h for h in candidates if best is not None and not _is_ahead(best, h)]
    odd = [h for h in table if h.names and is_at_bound(h.fit)]
    rivals = select_irreducible(h for h in near if not any(_is_ahead(o, h) for o in odd if not _is_contained(h, o)))
    return _common_part(rivals, candidates) or rivals


def _common_part(rivals: Sequence[Hypothesis], candidates: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The common part of all rivals, where it may dominate by itself: it is certain, the rest is not."""
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
    """Whether an effect is dry friction of the joint's bearing, or reduces to one."""
    cls = EFFECTS[name]
    return (cls.acts == "drive" and not cls.geared) or (cls.reduces_to is not None and _is_dry(cls.reduces_to))


def may_dominate(hypothesis: Hypothesis, base: Hypothesis, settings: JudgementSettings) -> bool:
    """Whether a set consists of effects that every machine has, with a loss and at most one dry friction, all
    parameters plausible and off their bounds, and halves the gap in most runs that show one and in half of the test
    runs among these."""
    classes = [EFFECTS[name] for name in hypothesis.names]
    one_friction = sum(_is_dry(name) for name in hypothesis.names) <= 1
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
