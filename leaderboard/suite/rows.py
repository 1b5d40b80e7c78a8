"""The rows of the suite: which method, with which settings, on which data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from freeart21.errors import FreeArtError
from leaderboard.reference import Kind

RowGroup = Literal["reference", "ours", "pieces", "paper", "paper-pieces", "sensors"]
GROUPS: tuple[RowGroup, ...] = get_args(RowGroup)


@dataclass(frozen=True)
class SuiteRow:
    """One row of the suite's table."""

    name: str
    group: RowGroup
    what: str
    """Its description, one line."""
    settings: dict[str, Any] = field(default_factory=dict)
    """For `freeart21 reconstruct --settings FILE`: what differs from the default."""
    reference: Kind | None = None
    """Kind of reference answers, made from the truth without a solver."""
    exported: bool = True
    """Whether its answers are exported and their assets scored."""
    sensor: str | None = None
    """Sensor with which the same objects and motions are recorded again; these are solved and scored instead."""

    @property
    def kind(self) -> str:
        """The kind of its solving jobs; all jobs of a kind share one rate."""
        return "reconstruct-paper" if self.settings.get("segmentation") == "paper" else "reconstruct"


def _piece(name: str, what: str, **settings: dict[str, Any]) -> SuiteRow:
    return SuiteRow(f"ours-{name}", "pieces", f"ours {what}", settings)


def _paper_piece(name: str, what: str, **settings: dict[str, Any]) -> SuiteRow:
    return SuiteRow(
        f"paper-{name}", "paper-pieces", f"the paper's segmentation {what}", {"segmentation": "paper", **settings}
    )


def _sensor(sensor: str, what: str) -> SuiteRow:
    return SuiteRow(f"ours-{sensor}", "sensors", f"ours, {what}", sensor=sensor)


_NEVER = 1e9

ROWS: tuple[SuiteRow, ...] = (
    SuiteRow(
        "truth", "reference", "the truth itself, from files: must score perfectly", reference="truth", exported=False
    ),
    SuiteRow("truth-exported", "reference", "the truth as an asset: what the export costs", reference="truth"),
    SuiteRow("static", "reference", "nothing moves: must score badly", reference="static", exported=False),
    SuiteRow("random", "reference", "random numbers: must score badly", reference="random", exported=False),
    SuiteRow("ours", "ours", "our solver as it is"),
    _piece("no-track-filters", "with all tracks", tracks={"visibility_filter": False, "displacement_filter": False}),
    _piece("no-colour", "without colour in registration", evidence={"colour_weight": 0.0}),
    _piece("one-beginning", "from one seed", growth={"beginnings": 1}),
    _piece("one-attempt", "with one growth", growth={"attempts": 1}),
    _piece("no-even-motion", "without the prior of even motion", growth={"surprise_weight": 0.0}),
    _piece("no-recovery", "without finding lost states again", growth={"surprising_cost": _NEVER}),
    _piece("no-propagation", "without what neighbouring frames believe", labels={"propagation": 0.0}),
    _piece("no-votes", "without what all frames believe", labels={"rounds_of_votes": 0}),
    _piece("no-pieces", "without growing anew where it was lost", pieces={"most": 0}),
    _piece("no-exchanges", "without turning back exchanged parts", exchanges={"most": 0}),
    _piece("no-gaps", "without joining over hidden frames", gaps={"shortest_gap": 1_000_000, "jump": _NEVER}),
    _piece("no-loops", "without pairs of distant frames", poses={"loops": 0}),
    _piece("paper-type", "with the paper's rule for the joint's type", joint={"type_rule": "paper"}),
    _piece("no-noise-resistance", "without robust weights in the joint", joint={"noise_resistance": False}),
    _piece("no-gaussians", "without Gaussians", gaussians={"refine": False}),
    _piece("no-end-to-end", "with Gaussians that leave the motion as it is", gaussians={"end_to_end": False}),
    _piece("no-blended-rendering", "with Gaussians of one part each", gaussians={"blended": False}),
    SuiteRow("paper", "paper", "the paper's segmentation, our re-making", {"segmentation": "paper"}),
    _paper_piece("no-smooth", '"w/o Smooth Loss"', paper={"use_smoothness": False}),
    _paper_piece("no-init", '"w/o Init Loss"', paper={"use_init": False}),
    _paper_piece("no-noise-resistance", "without noise resistance", joint={"noise_resistance": False}),
    _paper_piece("no-blended-rendering", '"w/o Blended Rendering"', gaussians={"blended": False}),
    _paper_piece("no-end-to-end", "without end-to-end optimisation", gaussians={"end_to_end": False}),
    _sensor("noise2", "2 % of noise on the depth"),
    _sensor("tof", "a time-of-flight camera"),
    _sensor("blur", "motion blur"),
    _sensor("hand", "a hand that holds the object"),
)


def choose_rows(names: Sequence[str]) -> list[SuiteRow]:
    """The rows with the given names or groups, in the suite's order; all for no names.

    Raises FreeArtError when a name is unknown.
    """
    known = {row.name: row for row in ROWS}
    for name in names:
        if name not in known and name not in GROUPS:
            raise FreeArtError(f"unknown row '{name}'; groups: {', '.join(GROUPS)}; rows: {', '.join(known)}")
    return [row for row in ROWS if not names or row.name in names or row.group in names]
