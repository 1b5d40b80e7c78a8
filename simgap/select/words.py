"""Numbers and effects as text for users."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np

from freeart21.effects import ASSET_ERRORS, EFFECTS
from freeart21.effects.base import Effect
from freeart21.joint import JointType
from simgap.verdict import Correction, Use


def effect_label(name: str) -> str:
    """The effect of this name in words."""
    return EFFECTS[name].label if name in EFFECTS else name.replace("_", " ")


def amount(value: float, unit: str) -> str:
    """A number with its SI unit as people write it, such as '12 mN m'."""
    unit = unit.replace("*", " ")
    if unit == "1":
        return f"{value:.3g}"
    if unit == "rad":
        return f"{np.degrees(value):.3g}°"
    size = abs(value)
    if unit in ("m", "s", "N m", "N", "m/rad") and 0 < size < 0.1:
        return f"{1e3 * value:.3g} m{unit}" if size >= 1e-4 else f"{1e6 * value:.3g} µ{unit}"
    return f"{value:.3g} {unit}"


def effect_words(effect: Effect, joint_type: JointType) -> str:
    """An effect with its parameters, such as 'dry friction (level 0.12 N m)'; defaults are omitted."""
    nothing = {field.name: field.default for field in dataclasses.fields(effect)}  # type: ignore[arg-type]
    numbers = ", ".join(
        f"{name} {amount(getattr(effect, name), spec.unit(joint_type))}"
        for name, spec in effect.parameters(joint_type).items()
        if getattr(effect, name) != nothing[name]
    )
    return f"{effect_label(effect.name)} ({numbers})"


def correction_words(corrections: Sequence[Correction]) -> str:
    """The asset's corrected parameters."""
    templates = {name: text for cls in ASSET_ERRORS.values() for name, text in cls.phrases.items()}
    words = []
    for c in corrections:
        value, low, high = (f"{v:.4g}" if c.unit == "1" else amount(v, c.unit) for v in (c.value, c.low, c.high))
        words.append(f"{templates[c.name].format(value)} ({low} to {high})")
    return " and ".join(words)


def span_text(quantity: str, low: float, high: float, joint_type: JointType) -> str:
    """A range of a quantity in degrees or centimetres, their speeds, or seconds."""
    if quantity == "time":
        return f"{low:.1f} to {high:.1f} s"
    factor, unit = (np.degrees(1.0), "°") if joint_type == "revolute" else (100.0, " cm")
    per = "/s" if quantity == "velocity" else ""
    digits = max(0, 1 - int(np.floor(np.log10(max(factor * (high - low), 1e-6)))))
    ends = [f"{round(factor * v, digits) + 0.0:.{digits}f}" for v in (low, high)]
    return f"{ends[0]} to {ends[1]}{unit}{per}"


_CLOSED = re.compile(r"With it -?\d+% of the gap on [^.;]* is gone")
_DIFFER, _LEFT = re.compile(r"differ by (?=[\d.])[^,]*(?=,)"), re.compile(r"what is left \([^)]*\)")
_REMAINS = re.compile(r"hat remains, [^,]* or \S+ times")
_USE_TEXT = {"fitted": "that it was fitted to", "choosing": "that chose it", "confirming": "kept to confirm it"}


def runs_text(uses: Sequence[Use], in_turn: bool = False) -> str:
    """The runs that a figure is about, such as '2 runs kept to confirm it'. `in_turn`: each run was held out of the fit
    that it is judged by."""
    if in_turn:
        return (
            f"{_runs(len(uses))}, each held out in turn" if len(uses) != 1 else "1 run, its stretches held out in turn"
        )
    return " and ".join(f"{_runs(uses.count(use))} {did}" for use, did in _USE_TEXT.items() if use in uses)


def _runs(count: int) -> str:
    return f"{count} run{'s' * (count != 1)}"


def closed_text(part: float, which: str) -> str:
    """The share of the gap beyond noise that is closed on the runs `which`, at most all of it."""
    return f"With it {min(part, 1.0):.0%} of the gap on {which} is gone"


def replace_closed_part(sentence: str, part: float, which: str) -> str:
    """The sentence with another closed share, of other runs."""
    return _CLOSED.sub(closed_text(part, which), sentence)


def replace_amounts(sentence: str, before: float, after: float, floor: float, unit: str) -> str:
    """The sentence with the fits' RMS replaced by those of replayed runs."""
    for pattern, now in (
        (_DIFFER, f"differ by {amount(before, unit)}"),
        (_LEFT, f"what is left ({amount(after, unit)})"),
        (_REMAINS, f"hat remains, {amount(after, unit)} or {after / floor:.3g} times"),
    ):
        sentence = pattern.sub(now, sentence)
    return sentence


def number_text(value: float, unit: str) -> str:
    """A parameter as a table shows it: `amount`, or "no bound"."""
    if not np.isfinite(value):
        return "no bound"
    return amount(value, unit)


def capitalise(text: str) -> str:
    """The text with its first letter in upper case."""
    return text[:1].upper() + text[1:]
