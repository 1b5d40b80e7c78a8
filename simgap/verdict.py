"""The result of `gap`: missing effects, where they act, confidence, and the next experiment."""

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
"""A run is used to fit models, to choose among them, or to confirm the choice."""
Answer = Literal["no_gap", "named", "ambiguous", "unexplained", "not_excited"]
Quantity = Literal["position", "force", "picture"]
GEOMETRY = "geometry"
"""Regime of gaps in part poses: metres off the joint."""


@dataclass(frozen=True)
class NamedEffect:
    """A named effect with 90 % intervals of its parameters."""

    effect: Effect
    low: dict[str, float]
    high: dict[str, float]


@dataclass(frozen=True)
class Correction:
    """A parameter of the asset itself that was estimated and written into its files."""

    name: str
    """Parameter of an `AssetError` of the library (`freeart21.effects.ASSET_ERRORS`)."""
    unit: str
    """"1" for factors, "rad" for angles."""
    value: float
    low: float
    """90 % interval, with all other parameters of the asset free."""
    high: float


@dataclass(frozen=True)
class Region:
    """A range of some quantity in which simulation and measurement differ."""

    quantity: str
    """For example position, velocity, distance since reversal, distance to limit, command, time."""
    low: float
    high: float
    p_value: float
    text: str


@dataclass(frozen=True)
class RunGap:
    """RMS difference between simulation and measurement of one run: rad or m, or N*m or N.

    In a published verdict these are replays of files (`simgap.prove.replay`); NaN for a run that was not replayed.
    """

    run: str
    before: float
    """With the asset as given."""
    after: float
    """With the delivered asset."""
    floor: float
    """RMS of the sensor's noise."""
    held_out: bool
    regime: str
    """Kind of motion, such as 'free slow'."""
    use: Use = "fitted"
    trial: float | None = None
    """With a trial repair that was not delivered; None without one."""


@dataclass(frozen=True)
class Proof:
    """The replay behind the numbers, and how to repeat it."""

    engine: str
    version: str
    repeat: dict[str, str]
    """Command lines: `before`, `after`, and `trial` for a trial repair that was not delivered."""
    witness: dict[str, Any]
    """Result of a second engine: `engine` with `version` and `gap` of each run, or why it is `absent`."""
    runs: dict[str, str] = field(default_factory=dict)
    """Run name to the SHA-256 of its file."""


GAP_THRESHOLD = 1.35
"""Normalised RMS above which a run shows a gap. Above 1 because the noise is an estimate."""


def root_mean_square(values: ArrayLike) -> float:
    """Of all values; 0 for an empty array."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else 0.0


def shows_gap(gaps: Sequence[RunGap]) -> bool:
    """Whether any of these runs shows a gap."""
    return any(gap.before > GAP_THRESHOLD * gap.floor for gap in gaps)


def closes_gap(gaps: Sequence[RunGap], most: float) -> bool:
    """Whether at most the share `most` of the gap beyond noise remains, over all runs, each normalised by its noise."""
    before, after = (root_mean_square([getattr(g, k) / g.floor for g in gaps]) for k in ("before", "after"))
    return after**2 - 1 <= most**2 * max(before**2 - 1, 0.0)


def deciding_runs(gaps: Sequence[RunGap]) -> list[RunGap]:
    """The runs that decide what an answer is worth: confirming ones, else choosing ones, else fitted ones; the first
    kind in which a run shows a gap."""
    for use in ("confirming", "choosing", "fitted"):
        found = [gap for gap in gaps if gap.use == use]
        if any(gap.before > GAP_THRESHOLD * gap.floor for gap in found):
            return found
    return list(gaps)


def unit_of(by: Quantity, joint_type: JointType) -> str:
    """SI unit of the compared quantity; empty for pictures, where every gap has its own."""
    turns = joint_type == "revolute"
    return {"position": "rad" if turns else "m", "force": "N*m" if turns else "N", "picture": ""}[by]


@dataclass(frozen=True)
class Verdict:
    """Result of `freeart21 gap`."""

    verdict: Answer
    effects: tuple[NamedEffect, ...]
    """Missing effects, strongest first; for an ambiguous verdict those of the most probable set."""
    where: tuple[Region, ...]
    gaps: tuple[RunGap, ...]
    rivals: tuple[tuple[str, ...], ...]
    """Sets of effects that the data cannot distinguish, the most probable first; empty without doubt."""
    next_experiment: str | None
    """What to record to distinguish the rivals, or to excite what did not move."""
    sentence: str
    """The verdict in words, for users."""
    added: tuple[str, ...] = ()
    """Names of the effects in the delivered asset: those that are certain and improved the replay in SAPIEN."""
    notes: tuple[str, ...] = ()
    """What of the data was left out or thinned, and why: a line each."""
    in_part: bool = False
    """Whether only the dominant effects are named, and a residual above the noise has no name."""

    corrections: tuple[Correction, ...] = ()
    """Changes of the asset's own inertia and weight in the delivered asset."""
    holding: float | None = None
    """How replays interpolate inputs of unknown interpolation: 0 smooth, 1 zero-order hold."""
    by: Quantity = "position"
    """The compared quantity. Gaps are in its unit."""
    judged_by: dict[str, Any] = field(default_factory=dict)
    """Version, digest of the code and every number that decides."""
    proof: Proof | None = None
    """Of gaps in position; None without a replay."""

    @property
    def uses(self) -> dict[str, Use]:
        """Run name to its use, by its motion where it has one."""
        uses: dict[str, Use] = {}
        for gap in self.gaps:
            uses.setdefault(gap.run, gap.use)
        return uses

    def to_json(self, joint_type: JointType) -> dict[str, Any]:
        """The contents of verdict.json."""
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
        """Write verdict.json atomically, with the names of the other files in its folder under "files"."""
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
