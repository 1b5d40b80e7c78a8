"""Which explanation stands: the smallest set of effects that predicts runs it never saw, and its rivals.

A real effect is never just the library's formula, so a set explains the runs when they are met with the sizes of its
effects free to depart from their formulas by the form tolerance. What is named is the smallest set that does; sets of
that size that do as well by their plain formulas are rivals. When none does, nothing is named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from simgap.fitting import alike
from simgap.fitting.fit import tempered, unit_of
from simgap.fitting.search import PLAINER, Search, beside, prompt, relaxed
from simgap.judgement.drift import Drift
from simgap.judgement.judge import Fold, Judged, beats, but_worst, judged, loosened, p_value, rms
from simgap.judgement.objections import bounded, drifting, helps, hollow, may_be_else, springs_back, stands, surpassed
from simgap.settings import ChoiceSettings

_NEAR = 0.5
"""Part of the gap that a single effect may leave and still be asked whether it changes over the session."""
_AS_WELL = 1.1
"""Times its sum of squares below which a plainer set fits the same runs as well as a more general one: less than what
a gap is, in floors."""
_ANEW = 0.5
"""Part of its sum of squares to which a set must fall to be looked at again."""


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
    refused: bool = False
    """Whether a set explained the runs, and something that has no name may be all that it stands for."""
    in_part: bool = False
    """Whether the sets of `explaining` are but what dominates: they leave a remainder without a name."""


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
    bar = float(np.hypot(settings.explained, settings.explained_part * base.borne))
    clear = max(base.borne, rms(but_worst(base.fit.residuals))) > settings.plain_gap
    gap = bool((p < settings.p_value and closed > settings.least_gap) or clear)
    if not gap:
        return Choice(base, p, (), best, bar, False, tuple(tried))
    contenders = first + instead(first, search, folds)
    stood: list[Judged] = []
    for size in range(1, settings.max_effects + 1):
        doubtful = [
            (j.error > settings.explained or springs_back(j.fit)) and j.borne < settings.form_factor * bar
            for j in contenders
        ]
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
            others = [j for j in contenders if j.error <= most and not bounded(j)]
            standing = [j for j in others if not any(_is_within(n, j, settings) for n in standing)] or standing
            break
        if standing and not beats(min(j.error for j in contenders), reach, settings):
            break  # not even a larger set does much better: the rest is form
        stood = standing or stood
    standing = standing or stood
    found = last(standing, tried, base, search, folds, bar, settings) if standing else ()
    if found:
        drifts = [drifting(j, folds, settings) for j in found]
        lasting = tuple(j for j, drift in zip(found, drifts, strict=True) if not drift)
        if not lasting or (len(lasting) == 1 and surpassed(lasting[0], search, base, settings)):
            drift = None if lasting else drifts[0]
            return Choice(base, p, (), (lasting or found)[0], bar, True, tuple(tried), drift, refused=True)
        lasting = tuple(as_added(j, search, folds, settings) for j in lasting)
        return Choice(base, p, lasting, lasting[0], bar, True, tuple(tried))
    alone = min((j for j in tried if len(j.names) == 1), key=lambda j: j.error)
    drift = drifting(alone, folds, settings) if alone.floors < _NEAR * base.floors else None
    best = min(tried, key=lambda j: j.error)
    return Choice(base, p, (), best, bar, True, tuple(tried), drift, refused=bool(standing))


def last(
    standing: list[Judged],
    tried: list[Judged],
    base: Judged,
    search: Search,
    folds: tuple[Fold, ...],
    bar: float,
    settings: ChoiceSettings,
) -> tuple[Judged, ...]:
    """Those of the standing sets, of their plainer forms and of their twins between which the runs do not decide; none
    where all become sets at a bound, or have catches that may as well be nothing."""
    missing = {names for j in standing for names in _plainer(j.names) if set(names) <= set(search.names)}
    missing -= {j.names for j in standing}
    standing = standing + [loosened(judged(search.of(names), folds), folds) for names in sorted(missing)]
    standing = [j for j in twins(standing, search, folds) if not bounded(j)]
    costs = {j.names: j.fit.cost for j in standing}
    plain = {j.names: min((costs[n] for n in _plainer(j.names) if n in costs), default=np.inf) for j in standing}
    more = {j.names: plain[j.names] > _AS_WELL * j.fit.cost and not hollow(j, search) for j in standing}
    standing = [j for j in standing if more[j.names] or np.isinf(plain[j.names])]
    reach = min((j.reach for j in standing), default=np.inf)
    standing = [j for j in standing if j.reach <= settings.explained or not beats(reach, j.reach, settings)]
    needed = [earned(j, base, search, folds, bar, settings) for j in standing]
    if any(j.names not in costs for j in needed):  # what is left has rivals and twins of its own
        names, most = {j.names for j in needed}, settings.rival * min(j.error for j in needed)
        like = [j for j in tried if len(j.names) in map(len, names - costs.keys()) and j.error < most]
        needed += [loosened(j, folds) for j in like if j.names not in names]
        needed = [j for j in twins(needed, search, folds) if not bounded(j) and helps(j, base, settings)]
    found = rivals(needed, settings) if needed else ()
    return tuple(j for j in found if not may_be_else(j, search, folds, settings))


def as_added(judgement: Judged, search: Search, folds: tuple[Fold, ...], settings: ChoiceSettings) -> Judged:
    """The set with the parameters that make a simulator come nearest, which knows no build-up of friction and nothing
    but formulas; and what they become when its sizes are free."""
    free = judgement.free or relaxed(judgement.fit, search.train)
    fit = prompt(judgement.fit, search.train)
    if beats(free.level, fit.level, settings):
        fit = beside(fit, free, search.train)
    return replace(judgement if fit is judgement.fit else judged(fit, folds), free=free)


def instead(contenders: list[Judged], search: Search, folds: tuple[Fold, ...]) -> list[Judged]:
    """What sets at a bound become: with a spring in the place of a wide notch, single ones with a plainer effect."""
    known, found = {j.names for j in contenders}, []
    for j in contenders:
        if bounded(j):
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
        most = max(bar, settings.rival * judgement.borne)
        if _freed(smaller) <= settings.rival * _freed(judgement):  # the member does but what the form of the rest does
            most = max(most, settings.rival * bar)
        about = stands(smaller, base, most, settings)
        well = smaller.reach <= settings.explained
        if about and (well or not beats(judgement.error, smaller.reach, settings)):
            return earned(smaller, base, search, folds, bar, settings)
    return judgement


def _freed(judgement: Judged) -> float:
    """Floors that are left of the runs that it was fitted to, its sizes free if they were freed."""
    return (judgement.free or judgement.fit).level


def _is_within(smaller: Judged, larger: Judged, settings: ChoiceSettings) -> bool:
    """Whether the larger set, or what it becomes in special cases, is but the smaller one with more beside it, and not
    even much better than its form."""
    more = smaller.reach > settings.explained and beats(larger.error, smaller.reach, settings)
    within = any(set(smaller.names) <= set(names) for names in (larger.names, *_plainer(larger.names)))
    return within and not more


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
        as_well = j.learned <= best.learned or (not own_kind and j.fit.cost < best.fit.cost + settings.rival_sum * unit)
        if as_well and j.borne <= best.borne:
            return True  # but for one run on a hair
        if j.error**2 - best.error**2 > settings.rival_power and all(
            beats(of_best, of_it, settings) for of_best, of_it in ((best.error, j.error), (best.learned, j.learned))
        ):
            return False  # the best leaves next to nothing, and this more, of all runs
        return j.error < settings.rival * best.error and (own_kind or as_well)

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
