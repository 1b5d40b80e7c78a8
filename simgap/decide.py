"""From what stands to what is said: names with intervals, rivals and the experiment that parts them, and a sentence."""

from __future__ import annotations

import numpy as np

from freeart21.effects import Effect
from freeart21.effects.armature import Armature
from simgap.choose import Choice
from simgap.data import FitRun
from simgap.drift import Drift
from simgap.experiment import next_experiment
from simgap.fit import Fit, Problem, information, tempered, unit_of
from simgap.floor import Floor
from simgap.guess import neutral_value
from simgap.judge import Judged
from simgap.settings import ChoiceSettings
from simgap.theory import FORM_WAYS, SHAFT, Reader
from simgap.verdict import Named, RunGap, Verdict
from simgap.words import amount, capital, closed_text, effect_words, plain

_ODD = 3.0
"""Times what the other runs are off by at which a run is spoken of."""
_NORMAL_90 = 1.645
_NEAR = 0.5
"""Part of the gap that the best try may leave and still be told of where nothing explains it."""


def moves_enough(runs: tuple[FitRun, ...], floor: Floor, settings: ChoiceSettings) -> bool:
    """Whether any run moves by more than the sensor's noise can hide."""
    return max(float(np.ptp(run.q)) for run in runs) > settings.least_motion * floor.still


def says_enough(runs: tuple[FitRun, ...], settings: ChoiceSettings) -> bool:
    """Whether there are readings enough to fit some and hold out others."""
    return sum(len(run.q) for run in runs) >= settings.least_readings


def silent_verdict(runs: tuple[FitRun, ...], floor: Floor, moved: bool) -> Verdict:
    """Nothing moved, or hardly anything was read: nothing is known."""
    gaps = tuple(RunGap(r.name, floor.still, floor.still, floor.still, bool(r.held_out), r.regime) for r in runs)
    return Verdict(
        "not_excited",
        (),
        (),
        gaps,
        (),
        "Record some runs of a few seconds each, from all over its range."
        if moved
        else "Let it go from far off its rest position, or push it through its whole range, and record again.",
        f"{'There are too few readings' if moved else 'The joint hardly moved'}: these runs cannot tell whether "
        "anything is missing in the simulation.",
    )


def verdict_of(choice: Choice, runs: tuple[FitRun, ...], floor: Floor, problem: Problem) -> Verdict:
    """The verdict of a choice."""
    before = choice.base
    if not choice.gap:
        said = (
            f"Simulation and measurement agree: what is left ({_length(before.borne * floor.still, problem)}) "
            "is the sensor's noise and what the asset is known to be off by."
        )
        odd, far = max(((run, float(np.sqrt(np.mean(r * r)))) for run, r in before.strict.items()), key=lambda e: e[1])
        if far > _ODD * before.borne:
            said += f" But run {odd} goes another way, and nothing explains that one alone: record it again."
        return Verdict("no_gap", (), (), _gaps(runs, before, before, floor), (), None, said)
    if not choice.explaining:
        said = (
            f"Simulation and measurement differ by {_length(before.floors * floor.still, problem)}, and no effect of "
            "the library explains it"
        )
        if choice.best.names and choice.best.floors < _NEAR * before.floors:
            said += f"; the nearest, {_listed(choice.best)}, leaves "
            said += _length(choice.best.floors * floor.still, problem)
        later = None
        if choice.drift:
            said += f". {changing(choice.drift)}"
            later = "Move it for some minutes, then record these runs again, the last ones first."
        said += "."
        return Verdict("unexplained", (), (), _gaps(runs, before, before, floor), (), later, said)
    best = choice.explaining[0]
    named = named_effects(best)
    gaps = _gaps(runs, before, best, floor)
    kind = problem.plant.joint_type
    words = " and ".join(effect_words(n.effect, kind) for n in named)
    if len(choice.explaining) > 1:
        sets = tuple(j.names for j in choice.explaining)
        experiment = next_experiment([j.fit for j in choice.explaining], runs)
        or_else = ", or ".join(_listed(j) for j in choice.explaining)
        return Verdict("ambiguous", named, (), gaps, sets, experiment, f"These runs cannot decide: {or_else}.")
    idle = unmoved(best)
    if idle:
        said = f"Something is missing, perhaps {words}, but these runs do not move enough of it to say how much."
        wider = "Record larger and smaller motions over the whole range, with pushes of known size."
        return Verdict("not_excited", named, (), gaps, (), wider, said)
    closed = (before.floors - best.floors) / max(before.floors - 1.0, 1e-9)
    said = f"The simulation misses this: {words}. {closed_text(float(np.clip(closed, 0.0, 1.0)))}"
    return Verdict("named", named, (), gaps, (), None, said)


def changing(drift: Drift) -> str:
    """How an effect's size changes over the session."""
    way = "grows" if drift.last > drift.first else "falls"
    return (
        f"{capital(plain(drift.name))} is not the same all the session: its size {way} from {drift.first:.2g} times "
        f"the usual in the first run to {drift.last:.2g} in the last, as of what warms up, wears or slips"
    )


def named_effects(judgement: Judged) -> tuple[Named, ...]:
    """The effects with 90 % intervals, strongest first: the one without which most would be left.

    What a parameter becomes when the sizes are free to depart from their formulas is as good an estimate of it, as far
    as the runs tell it beside these departures; and the size of an effect that departs from its formula by some part of
    itself is known to that part only.
    """
    fit, unit = judgement.fit, unit_of(tempered(judgement.left))
    ranges, free = fit.theory.ranges(), judgement.free or fit
    errors = dict(zip(free.values, np.sqrt(np.diag(_covariance(free, unit))), strict=True))
    found = []
    for effect in fit.effects:
        own = {r.name: i for i, r in enumerate(ranges) if r.owner == effect.name}
        specs, part, ends = effect.parameters(), _departure(effect, free, errors), {}
        for name, i in own.items():
            x, key = fit.theta[i], (effect.name, name)
            size = 0.0 if is_place(effect, name) else x - neutral_value(type(effect)) * (i == min(own.values()))
            spread = _NORMAL_90 * np.sqrt(errors[key] ** 2 + (free.values[key] - x) ** 2 + (part * size) ** 2)
            ends[name] = max(x - spread, specs[name].lower), min(x + spread, specs[name].upper)
        if isinstance(effect, Armature):
            ends["throw_back"] = _thrown_back(fit, errors)
        low, high = ({name: float(end[k]) for name, end in ends.items()} for k in (0, 1))
        i = min(own.values())
        weight = (fit.theta[i] - neutral_value(type(effect))) ** 2 * fit.normal[i, i]
        found.append((float(weight), Named(effect, low, high)))
    found.sort(key=lambda pair: -pair[0])
    return tuple(named for _, named in found)


def _thrown_back(fit: Fit, errors: dict[tuple[str, str], float]) -> tuple[float, float]:
    """90 % interval of what an armature's shaft throws back; nothing where stops bounce by themselves."""
    at = next((i for i, r in enumerate(fit.theory.ranges()) if r.owner == SHAFT), None)
    if at is None:
        return 0.0, 0.0
    r, whole = fit.theory.ranges()[at], fit.theta.copy()
    whole[at] = 1.0
    share, spread = Reader(fit.theory).throw_back(whole, fit.effects), _NORMAL_90 * errors[r.owner, r.name]
    return share * max(fit.theta[at] - spread, r.lower), share * min(fit.theta[at] + spread, r.upper)


def is_place(effect: Effect, name: str) -> bool:
    """Whether a parameter of a force is a position."""
    spec = effect.parameters()[name]
    return effect.acts == "force" and spec.revolute_unit == "rad" and spec.lower < 0


def _departure(effect: Effect, free: Fit, errors: dict[tuple[str, str], float]) -> float:
    """Part of itself by which an effect departs from its formula in a fit in which it may, as far as that is known;
    what its kind usually does where the fit has no way for it."""
    ways = [key for key in free.values if key[0] == f"{effect.name} form" and key[1] in FORM_WAYS]
    told = np.sqrt(sum(free.values[key] ** 2 + errors[key] ** 2 for key in ways))
    return float(min(told, max(effect.departs))) if ways else max(effect.departs)


def _covariance(fit: Fit, unit: float) -> np.ndarray:
    """(p, p) of the parameters; `unit` is that of noise."""
    normal = information(fit, unit)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(scale, scale)


def unmoved(judgement: Judged) -> list[str]:
    """Names of the effects of which these runs tell no size, were all else known: they hardly stir them.

    What an effect shares with the asset's own doubts is no lack of motion, and more of the same would not part them.
    """
    fit, unit, found = judgement.fit, unit_of(tempered(judgement.left)), []
    ranges = fit.theory.ranges()
    for effect in fit.effects:
        own = [i for i, r in enumerate(ranges) if r.owner == effect.name and not np.isfinite(r.prior)]
        about = neutral_value(type(effect))
        block = fit.normal[np.ix_(own, own)] / unit
        scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
        inverse = np.linalg.pinv(block / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(scale, scale)
        spread = _NORMAL_90 * np.sqrt(np.diag(inverse))
        sizes = np.array([fit.theta[i] - (about if i == own[0] else 0.0) for i in own])
        forces = [i == own[0] or ranges[i].name in ("sine",) for i in own]
        if not any(abs(x) > 0.8 * s for x, s, force in zip(sizes, spread, forces, strict=True) if force):
            found.append(effect.name)
    return found


def _gaps(runs: tuple[FitRun, ...], before: Judged, after: Judged, floor: Floor) -> tuple[RunGap, ...]:
    """Root mean squares of every run: held out where it was, else as fitted."""

    def size(judgement: Judged, run: FitRun) -> float:
        residual = judgement.strict.get(run.name, judgement.fit.residuals.get(run.name))
        if residual is None:  # a single run was cut into stretches
            parts = [r for name, r in judgement.strict.items() if name.startswith(f"{run.name}#")]
            residual = np.concatenate(parts)
        return float(np.sqrt(np.mean((residual * _sigmas(residual, run)) ** 2)))

    return tuple(
        RunGap(
            run.name,
            size(before, run),
            size(after, run),
            float(np.sqrt(np.mean(run.sigma**2))),
            bool(run.held_out),
            run.regime,
        )
        for run in runs
    )


def _sigmas(residual: np.ndarray, run: FitRun) -> np.ndarray:
    return run.sigma if len(run.sigma) == len(residual) else np.full(len(residual), float(np.mean(run.sigma)))


def _listed(judgement: Judged) -> str:
    return " with ".join(f"{plain(name)} ({name})" for name in judgement.names)


def _length(value: float, problem: Problem) -> str:
    return amount(value, "rad" if problem.plant.joint_type == "revolute" else "m")
