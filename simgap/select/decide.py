"""From the choice to the verdict: effects with intervals, rivals, the next experiment and a sentence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from freeart21.joint import JointType
from simgap.fit.fit import Fit, Problem, residual_dispersion, robust_residuals
from simgap.fit.guess import is_linear_parameter
from simgap.measure.data import FitRun
from simgap.measure.noise import SensorNoise
from simgap.measure.stiction import StictionBound
from simgap.select.choose import Choice
from simgap.select.delivery import Delivery
from simgap.select.discrepancy import Discrepancy
from simgap.select.experiment import DISCREPANCY_EXPERIMENTS, next_experiment
from simgap.select.hypotheses import Hypothesis
from simgap.select.intervals import NORMAL_90, estimate_intervals
from simgap.select.split import Split
from simgap.select.words import amount, capitalise, closed_text, correction_words, effect_label, effect_words, runs_text
from simgap.settings import JudgementSettings
from simgap.verdict import Quantity, RunGap, Verdict, closes_gap, deciding_runs, root_mean_square, shows_gap, unit_of

_OUTLIER_RATIO = 3.0
"""Times the median run's RMS above which a run is mentioned."""
_REPORTED_RMS = 1.5
"""Normalised RMS of the median run above which a residual is mentioned."""
_REPORTED_SHARE = 0.5
"""Share of the gap that the nearest set may leave to be mentioned."""
_REPORTED_DISCREPANCY = 0.1
"""Share of the gap that a discrepancy must remove to be mentioned."""
_DISCREPANCY_TEXT = {
    "position": "a force that depends on where the joint is",
    "velocity": "friction that depends on speed in another way",
    "direction": "a push one way, or friction that differs by direction",
    "time": "a force that depends on the time since a run began",
    "flexing": "parts that flex between the sensor and the load",
    "session": "a size that changes over the session",
}


@dataclass(frozen=True)
class DeliveredFits:
    """The delivery, and fits of all runs with the asset as given and as delivered; only start states are fitted."""

    delivery: Delivery
    before: Fit
    after: Fit


def has_enough_motion(runs: tuple[FitRun, ...], noise: SensorNoise, settings: JudgementSettings) -> bool:
    """Whether any run moves by more than the noise can hide."""
    return max(float(np.ptp(run.q)) for run in runs) > settings.least_motion * noise.sigma_at_rest


def has_enough_readings(runs: tuple[FitRun, ...], settings: JudgementSettings) -> bool:
    """Whether there are enough readings to fit some and hold out others."""
    return sum(len(run.q) for run in runs) >= settings.least_readings


def not_excited_verdict(
    runs: tuple[FitRun, ...], noise: SensorNoise, moved: bool, joint_type: JointType, held: StictionBound | None = None
) -> Verdict:
    """The verdict where nothing moved or there are too few readings; it reports a stiction bound, if any."""
    gaps = tuple(
        RunGap(r.name, noise.sigma_at_rest, noise.sigma_at_rest, noise.sigma_at_rest, bool(r.held_out), r.regime)
        for r in runs
    )
    length, force = ("rad", "N*m") if joint_type == "revolute" else ("m", "N")
    later = "Let it go from far off its rest position, or push it through its whole range, and record again."
    if held is not None:
        most = amount(held.force, force)
        sentence = (
            f"The joint held against {most}, weight and commanded force together, and moved by "
            f"{amount(held.travel, length)}: what holds it, dry friction or a catch, is at least that. Beyond that"
        )
        later = f"Push harder than {most} until it moves. {later}"
    elif moved:
        sentence, later = (
            "There are too few readings:",
            "Record some runs of a few seconds each, from all over its range.",
        )
    else:
        sentence = "The joint hardly moved:"
    return Verdict(
        "not_excited",
        (),
        (),
        gaps,
        (),
        later,
        f"{sentence} these runs cannot tell whether anything is missing in the simulation.",
    )


def compared_quantity(problem: Problem) -> Quantity:
    """Position, or force where motion is prescribed."""
    return "force" if problem.inverse_dynamics else "position"


def make_verdict(
    choice: Choice,
    split: Split,
    delivered: DeliveredFits,
    runs: tuple[FitRun, ...],
    noise: SensorNoise,
    problem: Problem,
    settings: JudgementSettings,
) -> Verdict:
    """The verdict of a choice."""
    found = _draft_verdict(choice, split, delivered, runs, noise, problem)
    found = _confirm(found, problem, settings)
    if found.verdict == "unexplained" or (found.verdict == "no_gap" and not found.corrections):  # nothing is delivered
        found = replace(found, gaps=tuple(replace(gap, after=gap.before) for gap in found.gaps))
    if found.verdict in ("no_gap", "named", "ambiguous") and problem.unknown_inputs:
        found = replace(found, holding=delivered.delivery.holding)
    if not problem.inverse_dynamics:
        return found
    what = "torque" if problem.plant.joint_type == "revolute" else "force"
    sentence = f"Judged by the {what} that prescribed motion took, not by positions. {found.sentence}"
    return replace(found, sentence=sentence, by="force")


def _confirm(found: Verdict, problem: Problem, settings: JudgementSettings) -> Verdict:
    """The verdict as confirming runs leave it: a name needs a gap in these runs that the delivered asset mostly
    closes."""
    if found.verdict == "unexplained" and not shows_gap(found.gaps):
        return replace(found, verdict="no_gap", next_experiment=None, sentence=_agreement_text(found.gaps, problem))
    confirming = [gap for gap in found.gaps if gap.use == "confirming"]
    if not confirming or not (found.effects or found.corrections) or found.verdict == "not_excited":
        return found
    if shows_gap(confirming) and closes_gap(confirming, settings.dominant):
        return found
    words = [effect_words(n.effect, problem.plant.joint_type) for n in found.effects]
    nearest = " and ".join([*words, *([correction_words(found.corrections)] if found.corrections else [])])
    bare = replace(found, effects=(), rivals=(), in_part=False, corrections=(), next_experiment=None)
    of = runs_text([gap.use for gap in confirming])
    if shows_gap(confirming):
        was, now = (
            _amount_text(root_mean_square([getattr(g, k) for g in confirming]), problem) for k in ("before", "after")
        )
        sentence = (
            f"Simulation and measurement differ, and the nearest explanation, {nearest}, leaves {now} of {was} on "
            f"{of}, by its fit: it is none."
        )
        return replace(bare, verdict="unexplained", next_experiment=DISCREPANCY_EXPERIMENTS[""], sentence=sentence)
    others = [gap for gap in found.gaps if gap.use != "confirming"]
    odd = [gap for gap in others if gap.before > settings.plain_gap * gap.floor]
    names = ", ".join(gap.run for gap in odd)
    later = f"Record more motion like that of {names}, and hold half of it out."
    if len(odd) < (1 - settings.met) * len(others):
        sentence = f"Simulation and measurement agree on {of}; what others leave has no name that these confirm."
        return replace(bare, verdict="no_gap", sentence=sentence, next_experiment=later if odd else None)
    sentence = f"Simulation and measurement differ in {names}, perhaps by {nearest}; but no gap shows on {of}."
    return replace(bare, verdict="unexplained", next_experiment=later, sentence=sentence)


def _agreement_text(gaps: tuple[RunGap, ...], problem: Problem) -> str:
    """That simulation and measurement agree, and the residual of the median run."""
    left = _amount_text(float(np.median([gap.after for gap in gaps])), problem)
    return f"Simulation and measurement agree: what is left ({left}) is the sensor's noise."


def _draft_verdict(
    choice: Choice,
    split: Split,
    delivered: DeliveredFits,
    runs: tuple[FitRun, ...],
    noise: SensorNoise,
    problem: Problem,
) -> Verdict:
    before, gaps = choice.base, _run_gaps(runs, split, delivered)
    delivery, kind = delivered.delivery, problem.plant.joint_type
    deciding = deciding_runs(gaps)
    was, now = (root_mean_square([getattr(g, k) / g.floor for g in deciding]) for k in ("before", "after"))
    closed = float(np.clip((was - now) / max(was - 1.0, 1e-9), 0.0, 1.0))
    of = runs_text([gap.use for gap in deciding], len(split.folds) > 1 and not split.confirming)
    closing = f"{closed_text(closed, of)}."
    apart = [
        next_experiment([delivery.correction_fit, rival.fit])
        for rival in delivery.rivals
        if delivery.correction_fit is not None
    ]
    later = " ".join(dict.fromkeys(apart)) or None
    body = f"{correction_words(delivery.corrected)}, and the asset delivered says so" if delivery.corrected else ""
    for rival in delivery.rivals:
        it_is = " and ".join(effect_words(effect, kind) for effect in rival.effects)
        body += f"; or it may be {f'that {correction_words(rival.numbers)}' if rival.numbers else it_is}"
    if not choice.has_gap:
        sentence = (
            f"No effect is missing, but the asset itself is off: {body}. {closing}"
            if body
            else _agreement_text(gaps, problem)
        )
        odd, far = max(before.rms_by_run.items(), key=lambda entry: entry[1])
        if far > _OUTLIER_RATIO * before.median_rms:
            sentence += f" But run {odd} goes another way, and nothing explains that one alone."
            later = " ".join(filter(None, (f"Record run {odd} again.", later)))
        return Verdict("no_gap", (), (), gaps, (), later, sentence, corrections=delivery.corrected)
    if not choice.accepted:
        return _unexplained_verdict(choice, gaps, noise, problem)
    best = choice.accepted[0]
    named = delivery.with_delivered_values(estimate_intervals(best))
    rest = f" {capitalise(describe_residual(choice, runs, noise, problem))}" if choice.in_part else ""
    words = " and ".join(effect_words(n.effect, kind) for n in named)
    if len(choice.accepted) > 1:
        sets = tuple(j.names for j in choice.accepted)
        parted = next_experiment([j.fit for j in choice.accepted])
        or_else = ", or ".join(_set_text(j) for j in choice.accepted)
        sentence = (
            f"These runs cannot decide{' what dominates' * choice.in_part}: {or_else}.{shared_effects_text(sets)}{rest}"
        )
        return Verdict("ambiguous", named, (), gaps, sets, parted, sentence, in_part=choice.in_part)
    if find_unexcited(best):
        sentence = f"Something is missing, perhaps {words}, but these runs do not move enough of it to say how much."
        wider = "Record larger and smaller motions over the whole range, with pushes of known size."
        return Verdict("not_excited", named, (), gaps, (), wider, sentence)
    if body:
        words += f". Besides, {body}"
    steps: list[str | None] = [later]
    if not split.confirming:
        closing += " It is not confirmed: there are too few runs to keep some for that."
        steps.append("Record more runs like these: of five, or of two that are held out, one confirms the answer.")
    if choice.in_part:
        sentence = f"Most of what the simulation misses is this: {words}. {closing}{rest}"
    else:
        sentence = f"The simulation misses this: {words}. {closing}"
    if not choice.in_part and best.median_rms > _REPORTED_RMS:
        rest = _amount_text(best.median_rms * noise.sigma_at_rest, problem)
        sentence += f" What remains, {rest} or {best.median_rms:.2g} times the sensor's noise, has no name."
    steps += [_next_recording(choice)] if rest else []
    experiment = " ".join(filter(None, steps)) or None
    return Verdict(
        "named", named, (), gaps, (), experiment, sentence, in_part=choice.in_part, corrections=delivery.corrected
    )


def _unexplained_verdict(choice: Choice, gaps: tuple[RunGap, ...], noise: SensorNoise, problem: Problem) -> Verdict:
    """The verdict where nothing may be named: the nearest set, and the main discrepancy."""
    before, best = choice.base, choice.best
    sentence = (
        f"Simulation and measurement differ by {_amount_text(before.rms * noise.sigma_at_rest, problem)}, and no "
        "effect of the library explains it"
    )
    if best.names and best.rms < _REPORTED_SHARE * before.rms:
        size = _amount_text(best.rms * noise.sigma_at_rest, problem)
        sentence += f"; the nearest, {_set_text(best)}, leaves {size}, by its fit"
    rival = _main_discrepancy(choice)
    if rival is not None:
        sentence += f". Something without a name does better: {_DISCREPANCY_TEXT[rival.kind]}"
        changes = {name: by for name, by in rival.changes.items() if abs(by) > _REPORTED_DISCREPANCY}
        sentence += "".join(f"; {effect_label(name)} changes by {by:+.0%}" for name, by in changes.items())
    return Verdict("unexplained", (), (), gaps, (), _next_recording(choice), f"{sentence}.")


def _next_recording(choice: Choice) -> str:
    """What to record about a discrepancy."""
    rival = _main_discrepancy(choice)
    return DISCREPANCY_EXPERIMENTS[rival.kind if rival is not None else ""]


def _main_discrepancy(choice: Choice) -> Discrepancy | None:
    """The most probable discrepancy that removes part of the gap; None without one."""
    sure = [n for n in choice.discrepancies if n.gain > (n.error if n.kind == "session" else 0.0)]
    able = [
        n
        for n in sure
        if n.rms_removed > _REPORTED_DISCREPANCY * choice.base.rms or (n.kind == "session" and n.changes)
    ]
    return max(able, key=lambda n: n.gain, default=None)


def shared_effects_text(sets: tuple[tuple[str, ...], ...]) -> str:
    """The effects that all rivals have."""
    shared = [name for name in sets[0] if all(name in names for names in sets)]
    return f" Sure is {' and '.join(effect_label(name) for name in shared)}." if shared else ""


def describe_residual(choice: Choice, runs: tuple[FitRun, ...], noise: SensorNoise, problem: Problem) -> str:
    """What the dominant effects leave, and where most of it is: run, position and speed."""
    best, rival = choice.accepted[0], _main_discrepancy(choice)
    floors = {name: float(np.sqrt(np.mean(r * r))) for name, r in best.test_residuals.items()}
    name = max(floors, key=lambda run: floors[run])
    size = _amount_text(best.rms * noise.sigma_at_rest, problem)
    sentence = f"what remains, {size} or {best.rms:.3g} times the sensor's noise"
    sentence += f", has no name{f', and acts as {_DISCREPANCY_TEXT[rival.kind]}' if rival is not None else ''}"
    run = next((run for run in runs if run.name == name and len(run.q) == len(best.test_residuals[name])), None)
    if run is None:
        return f"{sentence}; it is most in {name}."
    power = best.test_residuals[name] ** 2
    fast = np.abs(run.speed) > np.median(np.abs(run.speed))
    high = run.joint_position > np.median(run.joint_position)
    ways = {
        "where it moves fast": fast,
        "where it moves slowly": ~fast,
        "in the upper half of its way": high,
        "in the lower half of its way": ~high,
    }
    where = max(ways, key=lambda way: float(power[ways[way]].sum()))
    return f"{sentence}; it is most in run {name}, {where}."


def find_unexcited(hypothesis: Hypothesis) -> list[str]:
    """Effects whose size these runs do not determine even with all else known. Confounding with the asset's own
    parameters does not count: more motion would not resolve it."""
    fit, unit, found = hypothesis.fit, residual_dispersion(robust_residuals(hypothesis.test_residuals)), []
    ranges = fit.model.ranges()
    for effect in fit.effects:
        free = [not np.isfinite(r.prior) or bool(effect.range_fields) for r in ranges]
        own = [i for i, r in enumerate(ranges) if r.owner == effect.name and free[i]]
        about = effect.neutral
        block = fit.normal[np.ix_(own, own)] / unit
        scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
        inverse = np.linalg.pinv(block / np.outer(scale, scale), rcond=1e-10, hermitian=True) / np.outer(scale, scale)
        spread = NORMAL_90 * np.sqrt(np.diag(inverse))
        sizes = np.array([fit.theta[i] - (about if i == own[0] else 0.0) for i in own])
        forces = [is_linear_parameter(ranges[i], [ranges[k] for k in own]) for i in own]
        if not any(abs(x) > 0.8 * s for x, s, force in zip(sizes, spread, forces, strict=True) if force):
            found.append(effect.name)
    return found


def _run_gaps(runs: tuple[FitRun, ...], split: Split, delivered: DeliveredFits) -> tuple[RunGap, ...]:
    """RMS of every run with the asset as given and as delivered: rad or m, or N*m or N."""
    return tuple(
        RunGap(
            run.name,
            root_mean_square(delivered.before.residuals[run.name] * run.sigma),
            root_mean_square(delivered.after.residuals[run.name] * run.sigma),
            root_mean_square(run.sigma),
            bool(run.held_out),
            run.regime,
            split.use(run.name),
        )
        for run in runs
    )


def _set_text(hypothesis: Hypothesis) -> str:
    return " with ".join(f"{effect_label(name)} ({name})" for name in hypothesis.names)


def _amount_text(value: float, problem: Problem) -> str:
    return amount(value, unit_of(compared_quantity(problem), problem.plant.joint_type))
