"""The verdict: effects that confirming frames confirm, and what remains unexplained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from freeart21.camera_faults import CameraFaults
from freeart21.effects.base import Effect
from freeart21.files.camera_faults import faults_json
from freeart21.joint import JointType
from simgap.film import geometry, pixel_faults
from simgap.film.choose import Chosen
from simgap.film.effects import camera_of
from simgap.film.maps import FilmMap, flagged_places
from simgap.film.missing import MissingPart
from simgap.film.samples import Rows
from simgap.film.scene import FilmScene
from simgap.models.localise import LEVEL, benjamini_hochberg
from simgap.select.words import amount, capitalise, effect_label, effect_words
from simgap.verdict import Answer as Answer  # annotations of the base classes, which pdoc resolves here
from simgap.verdict import Correction as Correction
from simgap.verdict import NamedEffect, RunGap, Verdict
from simgap.verdict import Proof as Proof
from simgap.verdict import Quantity as Quantity
from simgap.verdict import Region as Region
from simgap.verdict import Use as Use

MIN_SHARE = 0.1
"""Share of a gap that may remain without mention, and that a named effect must close. Not measured."""
REPORTED_RATIO = 2.0
"""Ratio to the noise above which a residual is mentioned."""
DOMINATED_SHARE = 0.5
"""Share of its gap that an effect must close on confirming frames where a discrepancy explains twice as much."""
T_90 = 1.895
"""Half width of a 90 % interval in standard errors: Student's t with the 7 degrees of freedom of 8 jackknife groups."""


@dataclass(frozen=True)
class QuantityGap(RunGap):
    """The gap of confirming frames in one quantity, its `regime`."""

    unit: str = ""


@dataclass(frozen=True)
class FilmVerdict(Verdict):
    """Result of `freeart21 gap` for two films."""

    gaps: tuple[QuantityGap, ...]
    missing_part: MissingPart | None = None
    cannot_tell: tuple[tuple[str, str], ...] = ()
    """Effects, and why these frames do not show them."""
    left: tuple[str, ...] = ()
    """Unexplained gaps, a line each."""
    frames: dict[str, list[int]] = field(default_factory=dict)
    """fit, choose and confirm to frame numbers."""
    camera: CameraFaults = field(default_factory=CameraFaults)
    """Certain faults, for the recorder."""
    poses: str = ""
    """Their source."""

    def to_json(self, joint_type: JointType) -> dict[str, Any]:
        """The contents of verdict.json; a camera's parameters have no joint type."""
        part = self.missing_part
        return {
            **super().to_json(joint_type),
            "missing_part": None if part is None else vars(part),
            "cannot_tell": [{"names": names, "why": why} for names, why in self.cannot_tell],
            "left": list(self.left),
            "frames": self.frames,
            "poses": self.poses,
            "camera": faults_json(self.camera),
        }


@dataclass(frozen=True)
class Confirmed:
    """The chosen effects that confirming frames confirm."""

    named: tuple[NamedEffect, ...]
    """Strongest first."""
    certain: tuple[str, ...]
    """Those in every rival set; only these go into the camera."""
    rivals: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    @property
    def best(self) -> CameraFaults:
        """With all named faults."""
        return camera_of(n.effect for n in self.named)

    @property
    def delivered(self) -> CameraFaults:
        """With certain faults."""
        return camera_of(n.effect for n in self.named if n.effect.name in self.certain)


def confirm(kinds: Sequence[Chosen], measure: Callable[[CameraFaults], dict[str, float]]) -> Confirmed:
    """The confirmed effects of every kind: each gains significantly on confirming frames, and the camera with all of
    them closes the gaps there. `measure` gives the gaps of confirming frames with a camera."""
    before, after = measure(CameraFaults()), measure(camera_of(e for c in kinds for e in c.effects))
    p_values = {name: p for c in kinds for name, p in c.p_values.items()}
    adjusted = dict(zip(p_values, benjamini_hochberg(np.array(list(p_values.values()))).tolist(), strict=True))
    named, certain, notes = list[tuple[float, NamedEffect]](), list[str](), list[str]()
    rivals: tuple[tuple[str, ...], ...] = ()
    for c in kinds:
        closed = max((1 - after[g] / max(before[g], 1e-12) for g in c.kind.gaps if g in before), default=0.0)
        for effect in c.effects:
            name, specs = effect.name, effect.parameters()
            why = c.refused.get(name, "")
            if adjusted[name] > LEVEL:
                why = f"not confirmed by the frames kept back (p = {adjusted[name]:.2g})"
            elif c.dominated and closed < DOMINATED_SHARE:
                why = f"errors by {c.dominated} explain far more"
            elif closed < MIN_SHARE:
                why = "frames that were not fitted hardly come nearer with it"
            if why:
                notes.append(f"{capitalise(effect_label(name))}: {why}")
                continue
            spread = {k: T_90 * c.errors.get(k, np.nan) for k in specs}
            low, high = ({k: c.values[k] + sign * spread[k] for k in specs} for sign in (-1, 1))
            named.append((c.scores[0].total - c.scores[-1].total, NamedEffect(effect, low, high)))
            certain += [name] if all(name in names for names in c.rivals) else []
        if len(c.rivals) > 1 and not rivals and any(n.effect.name in c.names for _, n in named):
            rivals = c.rivals
    named.sort(key=lambda each: -each[0])
    return Confirmed(tuple(n for _, n in named), tuple(certain), rivals, tuple(notes))


def verdict_of(
    kinds: Sequence[Chosen],
    found: Confirmed,
    gaps: tuple[QuantityGap, ...],
    maps: tuple[FilmMap, ...],
    part: MissingPart | None,
    scene: FilmScene,
    rows: Rows,
    frames: dict[str, list[int]],
) -> FilmVerdict:
    """The verdict; gaps are measured with the delivered camera (and, as a trial, with all named faults)."""
    distance = float(np.median(rows["z"]))
    unexplained = _list_unexplained(kinds, found, gaps, distance)
    answer: Any = "unexplained" if unexplained else "no_gap"
    if found.named or part is not None:
        answer = "ambiguous" if found.rivals else "named"
    large = {gap.regime for gap in gaps if gap.before > _bound(gap, distance)}
    return FilmVerdict(
        answer,
        found.named,
        tuple(w for gap, w in flagged_places(maps) if gap in large),
        gaps,
        found.rivals,
        next_film(answer, unexplained),
        _sentence(answer, found, part, unexplained),
        found.certain,
        found.notes,
        bool(unexplained) and answer in ("named", "ambiguous"),
        by="picture",
        missing_part=part,
        cannot_tell=_cannot_tell(kinds, scene, rows),
        left=tuple(unexplained),
        frames=frames,
        camera=found.delivered,
        poses=scene.placed.source,
    )


def next_film(answer: str, unexplained: Sequence[str]) -> str | None:
    """What to film where the answer has rivals or a residual; None otherwise."""
    purposes = {
        "ambiguous": "depth and lens differ there in how they go with distance, angle and place in the picture",
        "unexplained": "what stays there is the camera's, what does not is the object's",
    }
    if answer not in purposes and not unexplained:
        return None
    board = "Film a flat board of known size from half and from twice the distance, square on and tilted by 60 degrees"
    return f"{board}, all over the picture: {purposes.get(answer, purposes['unexplained'])}."


def size_text(value: float, unit: str) -> str:
    """A gap of pictures as text."""
    return f"{100 * value:.2g} %" if unit == "1" else amount(value, unit)


def _list_unexplained(
    kinds: Sequence[Chosen], found: Confirmed, gaps: Sequence[QuantityGap], distance: float
) -> list[str]:
    """Gaps above the noise without a name, a line each."""
    out = []
    fraying = any(n.effect.name.endswith(("holes", "flying_pixels")) for n in found.named)
    for gap in gaps:
        after = gap.after if gap.trial is None else gap.trial
        if after <= max(_bound(gap, distance), MIN_SHARE * gap.before):
            continue
        if gap.regime == geometry.GAPS[2] and fraying:
            continue  # lost and flying pixels at the rim change the outline, too
        best = kinds[0].scores[0].names
        how = (
            f", mostly by {best[-1]}" if gap.regime == geometry.GAPS[0] and best[-1:] and best != kinds[0].names else ""
        )
        out.append(f"{gap.regime} {size_text(after, gap.unit)}{how}")
    return out


def _bound(gap: QuantityGap, distance: float) -> float:
    """The size above which a gap is unexplained."""
    if gap.regime == geometry.GAPS[0]:
        return max(REPORTED_RATIO * gap.floor, geometry.LEAST_DEPTH * distance)
    if gap.regime in (pixel_faults.LOST, pixel_faults.FLYING):
        return gap.floor
    return (1.25 if gap.unit == "px" else REPORTED_RATIO) * gap.floor


def _cannot_tell(kinds: Sequence[Chosen], scene: FilmScene, rows: Rows) -> tuple[tuple[str, str], ...]:
    judged_effects = {name for c in kinds for name in c.kind.effects}
    out = []
    if not scene.placed.exact:
        why = (
            "the asset was reconstructed from this camera's own video and has taken it on in its size and shape; "
            "an asset of known size (export --scale, or a CAD model) would tell"
        )
        out.append(("depth_scale, depth_offset, depth_curve, focal_length, principal_point", why))
        out += [("gamma_drift", "light that moves over the asset's surface looks the same")] * scene.coloured
    if "depth_delay" not in judged_effects:
        out.append(("depth_delay", "the object hardly moves in the picture: under half a pixel a frame"))
    if not scene.coloured:
        out.append(("exposure_drift, gamma_drift", "the asset says nothing of its colours"))
    dark = float(np.quantile(rows["measured_brightness"], 0.02))
    flat = float(np.degrees(np.arccos(np.clip(np.quantile(rows["cosine"], 0.02), 0, 1))))
    out += [("dark_holes", f"no surface is darker than {100 * dark:.0f} %")] * (dark > 0.3)
    out += [("grazing_holes", f"no surface is seen flatter than {flat:.0f} degrees")] * (flat < 55)
    return tuple(out)


def _fault_words(effect: Effect) -> str:
    """An effect with its parameters; of a drift its range."""
    values = effect.values()
    if not effect.name.endswith("_drift"):
        return effect_words(effect, "revolute")
    unit = next(iter(effect.parameters().values())).unit("revolute")
    return f"{effect_label(effect.name)} ({amount(max(values) - min(values), unit)} in all)"


def _sentence(answer: str, found: Confirmed, part: MissingPart | None, unexplained: Sequence[str]) -> str:
    lines = []
    sure = [_fault_words(n.effect) for n in found.named if n.effect.name in found.certain]
    if sure:
        lines.append(f"The camera has {', '.join(sure[:-1])}{' and ' * (len(sure) > 1)}{sure[-1]}.")
    if found.rivals:
        sets = ", or ".join(" and ".join(effect_label(n) for n in names) for names in found.rivals)
        lines.append(f"These frames cannot decide between {sets}.")
    if part is not None:
        sides = " x ".join(f"{1e3 * v:.0f}" for v in part.size_m)
        lines.append(f"The asset lacks something of about {sides} mm that moves with its {part.part} part.")
    if answer == "no_gap":
        lines.append("The simulated film is like the measured one: nothing exceeds what the comparison can tell.")
    if answer == "unexplained":
        lines.append("The films differ, and nothing in the library explains it.")
    if unexplained:
        lines.append(f"Left without a name: {'; '.join(unexplained)}.")
    return " ".join(lines)
