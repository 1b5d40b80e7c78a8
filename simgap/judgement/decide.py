"""From what stands to what is said: names with intervals, rivals and the experiment that parts them, and a sentence."""

from __future__ import annotations

import numpy as np

from simgap.fitting.fit import Problem, tempered, unit_of
from simgap.fitting.guess import neutral_value
from simgap.judgement.choose import Choice
from simgap.judgement.drift import Drift
from simgap.judgement.experiment import next_experiment
from simgap.judgement.intervals import NORMAL_90, with_intervals
from simgap.judgement.judge import Judged
from simgap.judgement.words import amount, capital, closed_text, effect_words, plain, runs_text
from simgap.measure.data import FitRun
from simgap.measure.floor import Floor
from simgap.settings import ChoiceSettings
from simgap.verdict import RunGap, Verdict, unseen

_ODD = 3.0
"""Times what the other runs are off by at which a run is spoken of."""
_REMAINS = 1.5
"""Floors that an explanation leaves, but of the run that is met worst, from which on the rest is spoken of."""
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
    named = with_intervals(best)
    rest = f" {capital(remainder(best, runs, floor, problem))}" if choice.in_part else ""
    gaps = _gaps(runs, before, best, floor)
    kind = problem.plant.joint_type
    words = " and ".join(effect_words(n.effect, kind) for n in named)
    if len(choice.explaining) > 1:
        sets = tuple(j.names for j in choice.explaining)
        experiment = next_experiment([j.fit for j in choice.explaining], runs)
        or_else = ", or ".join(_listed(j) for j in choice.explaining)
        said = f"These runs cannot decide{' what dominates' * choice.in_part}: {or_else}.{sure_of(sets)}{rest}"
        return Verdict("ambiguous", named, (), gaps, sets, experiment, said, in_part=choice.in_part)
    idle = unmoved(best)
    if idle:
        said = f"Something is missing, perhaps {words}, but these runs do not move enough of it to say how much."
        wider = "Record larger and smaller motions over the whole range, with pushes of known size."
        return Verdict("not_excited", named, (), _gaps(runs, before, before, floor), (), wider, said)
    alone = unseen(gaps)
    was, now = (j.fit.level if alone else j.floors for j in (before, best))
    closed = float(np.clip((was - now) / max(was - 1.0, 1e-9), 0.0, 1.0))
    flags = [bool(run.held_out) for run in runs]
    of = runs_text([out for out in flags if out != alone], not any(flags))
    closing = f"{closed_text(closed, of)}{'; no other run shows any' * alone}."
    if choice.in_part:
        said = f"Most of what the simulation misses is this: {words}. {closing}{rest}"
        return Verdict("named", named, (), gaps, (), None, said, in_part=True)
    said = f"The simulation misses this: {words}. {closing}"
    if best.borne > _REMAINS:
        rest = _length(best.borne * floor.still, problem)
        said += f" What remains, {rest} or {best.borne:.2g} times the sensor's noise, has no name."
    return Verdict("named", named, (), gaps, (), None, said)


def sure_of(sets: tuple[tuple[str, ...], ...]) -> str:
    """What all rivals have."""
    shared = [name for name in sets[0] if all(name in names for names in sets)]
    return f" Sure is {' and '.join(plain(name) for name in shared)}." if shared else ""


def remainder(best: Judged, runs: tuple[FitRun, ...], floor: Floor, problem: Problem) -> str:
    """What a name in part leaves, and where most of it is: in which run, at which places and speeds."""
    floors = {name: float(np.sqrt(np.mean(r * r))) for name, r in best.strict.items()}
    name = max(floors, key=lambda run: floors[run])
    said = f"what remains, {_length(best.floors * floor.still, problem)} or {best.floors:.3g} times the sensor's noise"
    run = next((run for run in runs if run.name == name and len(run.q) == len(best.strict[name])), None)
    if run is None:
        return f"{said}, has no name; it is most in {name}."
    power = best.strict[name] ** 2
    fast = np.abs(run.speed) > np.median(np.abs(run.speed))
    high = run.q > np.median(run.q)
    ways = {
        "where it moves fast": fast,
        "where it moves slowly": ~fast,
        "in the upper half of its way": high,
        "in the lower half of its way": ~high,
    }
    where = max(ways, key=lambda way: float(power[ways[way]].sum()))
    return f"{said}, has no name; it is most in run {name}, {where}."


def changing(drift: Drift) -> str:
    """How an effect's size changes over the session."""
    way = "grows" if drift.last > drift.first else "falls"
    return (
        f"{capital(plain(drift.name))} is not the same all the session: its size {way} from {drift.first:.2g} times "
        f"the usual in the first run to {drift.last:.2g} in the last, as of what warms up, wears or slips"
    )


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
        spread = NORMAL_90 * np.sqrt(np.diag(inverse))
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
