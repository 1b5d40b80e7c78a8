"""The answer: what is missing in the simulation, where, how sure, and what would tell more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from freeart21.effects import Effect
from freeart21.files import atomic
from freeart21.joint import JointType

SCHEMA = "freeart21/verdict/1"
Use = Literal["fitted", "choosing", "confirming"]
"""What a run is used for: to fit sets to, to choose among them, or to confirm the choice."""
Answer = Literal["no_gap", "named", "ambiguous", "unexplained", "not_excited"]
Quantity = Literal["position", "force", "picture"]
GEOMETRY = "geometry"
"""Regime of a gap that is counted in metres off the joint."""


@dataclass(frozen=True)
class NamedEffect:
    """One effect of the answer, with 90 % intervals of its parameters."""

    effect: Effect
    low: dict[str, float]
    high: dict[str, float]


@dataclass(frozen=True)
class Correction:
    """A number of the asset's own that was measured and written into its files."""

    name: str
    """`inertia` about the joint (mass on a slider) or `weight`, over what the asset says; `lean` of the weight's pull
    in the plane of the motion (along a slider), and `lean_across`."""
    unit: str
    """1 of a factor, rad of a lean."""
    value: float
    low: float
    """90 % interval, all else that the asset may be off by being as doubtful."""
    high: float


@dataclass(frozen=True)
class Region:
    """A range of some quantity in which simulation and measurement part."""

    quantity: str
    """Such as position, velocity, distance since reversal, distance to limit, command, time."""
    low: float
    high: float
    p_value: float
    text: str


@dataclass(frozen=True)
class RunGap:
    """How far simulation and measurement of one run are apart: root mean squares, rad or m, or N*m or N.

    Of positions, once it is published: replays of files (`simgap.prove.replay`), NaN for a run that was not replayed.
    """

    run: str
    before: float
    """By the asset that was given."""
    after: float
    """By the asset beside the verdict."""
    floor: float
    """What the sensor's own noise leaves."""
    held_out: bool
    regime: str
    """Which kind of motion the run is, such as 'small' or 'large' swings."""
    use: Use = "fitted"
    trial: float | None = None
    """By a trial repair that is not in the asset beside the verdict; None where there is no such repair."""


@dataclass(frozen=True)
class Proof:
    """What replayed the files, and how anybody repeats it."""

    engine: str
    version: str
    repeat: dict[str, str]
    """Command lines: `before`, `after`, and `trial` of a trial repair that is not in the asset."""
    witness: dict[str, Any]
    """A second engine's word: `engine`, with its `version` and `gap`, run by run, or why it is `absent`."""
    runs: dict[str, str] = field(default_factory=dict)
    """Run name to the SHA-256 of its file."""


GAP_THRESHOLD = 1.35
"""Floors from which on a run shows a gap of its own, the floor being an estimate."""


def root_mean_square(values: ArrayLike) -> float:
    """Of all values; 0 of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0


def shows_gap(gaps: Sequence[RunGap]) -> bool:
    """Whether any of these runs shows a gap of its own."""
    return any(gap.before > GAP_THRESHOLD * gap.floor for gap in gaps)


def closes_gap(gaps: Sequence[RunGap], most: float) -> bool:
    """Whether at most this part of the gap beyond noise is left of these runs together, each in its own floors."""
    before, after = (root_mean_square([getattr(g, k) / g.floor for g in gaps]) for k in ("before", "after"))
    return after**2 - 1 <= most**2 * max(before**2 - 1, 0.0)


def deciding_runs(gaps: Sequence[RunGap]) -> list[RunGap]:
    """The runs that tell what an answer is worth: those that confirm it, else those that chose it, else those that were
    fitted, of the first kind in which a run shows a gap at all."""
    for use in ("confirming", "choosing", "fitted"):
        found = [gap for gap in gaps if gap.use == use]
        if any(gap.before > GAP_THRESHOLD * gap.floor for gap in found):
            return found
    return list(gaps)


def unit_of(by: Quantity, joint_type: JointType) -> str:
    """SI unit of what was compared; none of pictures, where every gap has its own."""
    turns = joint_type == "revolute"
    return {"position": "rad" if turns else "m", "force": "N*m" if turns else "N", "picture": ""}[by]


@dataclass(frozen=True)
class Verdict:
    """What `freeart21 gap` found."""

    verdict: Answer
    effects: tuple[NamedEffect, ...]
    """The missing effects, strongest first; of an ambiguous verdict the best of the rivals."""
    where: tuple[Region, ...]
    gaps: tuple[RunGap, ...]
    rivals: tuple[tuple[str, ...], ...]
    """Sets of effects that the data can't tell apart, the best one first; empty when there is no doubt."""
    next_experiment: str | None
    """What would tell the rivals apart, or excite what lay still."""
    sentence: str
    """The verdict for a mechanic."""
    added: tuple[str, ...] = ()
    """Names of the effects that the asset beside the verdict got: those that are certain, and helped in SAPIEN."""
    notes: tuple[str, ...] = ()
    """What of the data was left out or thinned, and why: a line each."""
    in_part: bool = False
    """Whether what is named is but what dominates, or may be: a remainder above the sensor's noise has no name."""

    corrections: tuple[Correction, ...] = ()
    """What the asset's own inertia and weight were changed by in the asset beside the verdict."""
    holding: float | None = None
    """Where nobody knows how inputs go on between their rows, how replays take them: 0 smoothly, 1 held."""
    by: Quantity = "position"
    """What was compared: where the joint was, or the force that prescribed motion took. Gaps are in its unit."""
    judged_by: dict[str, Any] = field(default_factory=dict)
    """Version, digest of the code and every number that decides."""
    proof: Proof | None = None
    """Of the gaps of positions; None where nothing was replayed."""

    @property
    def uses(self) -> dict[str, Use]:
        """Run name to what the run was used for, by its motion where it has one."""
        uses: dict[str, Use] = {}
        for gap in self.gaps:
            uses.setdefault(gap.run, gap.use)
        return uses

    def to_json(self, joint_type: JointType) -> dict[str, Any]:
        """As it stands in verdict.json."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "in_part": self.in_part,
            "sentence": self.sentence,
            "effects": [_named_to_json(named, joint_type) for named in self.effects],
            "added": list(self.added),
            "corrections": [vars(corrected) for corrected in self.corrections],
            "holding": self.holding,
            "where": [vars(where) for where in self.where],
            "gap": [vars(gap) for gap in self.gaps if np.isfinite(gap.before)],
            "gap_of": {"quantity": self.by, "unit": unit_of(self.by, joint_type)},
            "rivals": [list(names) for names in self.rivals],
            "next_experiment": self.next_experiment,
            "notes": list(self.notes),
            "judged_by": self.judged_by,
            "proof": None if self.proof is None else vars(self.proof),
            "uses": self.uses,
        }

    def write(self, path: Path, joint_type: JointType) -> None:
        """Write verdict.json whole or not at all, with the names of the files that lie beside it ("files")."""
        files = sorted(file.relative_to(path.parent).as_posix() for file in path.parent.rglob("*") if file.is_file())
        atomic.write_json(path, {**self.to_json(joint_type), "files": files})


def _named_to_json(named: NamedEffect, joint_type: JointType) -> dict[str, Any]:
    entry_json = named.effect.to_json(joint_type)
    return {
        "name": entry_json["effect"],
        "parameters": {
            name: {**entry, "low": named.low[name], "high": named.high[name]}
            for name, entry in entry_json["parameters"].items()
        },
    }
