"""Protocols: named metrics with a unit, a direction and a penalty for failures, and the function that measures them.

Each protocol is a file of `leaderboard.protocols`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.joint import JointType
from freeart21.mesh import Mesh
from freeart21.reconstruction import Piece, Reconstruction
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard.published import PublishedRow

Group = Literal["revolute", "prismatic", "all"]
Render = NDArray[np.uint8] | None
"""The answer's render (height, width, 3) of one held-out query; None where it has none."""


class Scale(NamedTuple):
    """What metrics of one kind share: their units, direction and penalty, as in `Metric`."""

    revolute_unit: str | None
    prismatic_unit: str | None
    direction: Literal["up", "down"]
    penalty: float | None


FRACTION = Scale("fraction", "fraction", "up", 0.0)
DECIBELS = Scale("dB", "dB", "up", 0.0)
ANGLE = Scale("deg", "deg", "down", 90.0)
"""Of directions whatever their signs."""


@dataclass(frozen=True)
class Metric:
    """One metric of a protocol."""

    id: str
    revolute_unit: str | None
    """Unit where the true joint is revolute; None where there is no value. '%' is relative to the object's diagonal."""
    prismatic_unit: str | None
    """The same where the true joint is prismatic."""
    direction: Literal["up", "down"]
    """'up': larger is better."""
    penalty: float | None
    """Value for a failure, a missing sequence or (where it applies) a wrong joint type; None when it depends on the
    sequence, as `penalty_source` tells."""
    definition: str
    supplements: str | None = None
    """Id of the ranking metric that this one supplements; None for a ranking metric."""
    label: str = ""
    """Readable name, such as 'chamfer, moving part'."""
    column: str = ""
    """Column head in short tables; empty for metrics that they leave out."""
    needs: tuple[Piece, ...] = ()
    """Pieces of an answer that it needs: the value is None in every row of a method that lacks one."""
    prismatic_penalty: float | None = None
    """Penalty where the true joint is prismatic; None for the same as `penalty`."""
    penalty_source: str = "range of motion"
    """What the penalty is, when it depends on the sequence."""

    def unit(self, group: Group) -> str | None:
        """The unit in a group of sequences; None without a common one."""
        if group == "revolute":
            return self.revolute_unit
        if group == "prismatic":
            return self.prismatic_unit
        if None in (self.revolute_unit, self.prismatic_unit):
            return self.revolute_unit or self.prismatic_unit
        return self.revolute_unit if self.revolute_unit == self.prismatic_unit else None

    def penalty_for(self, joint_type: JointType, from_sequence: float | None = None) -> float | None:
        """The penalty for a sequence, in the metric's unit; `from_sequence` where it depends on the sequence."""
        if self.unit(joint_type) is None:
            return None
        if joint_type == "prismatic" and self.prismatic_penalty is not None:
            return self.prismatic_penalty
        return from_sequence if self.penalty is None else self.penalty

    @property
    def penalty_text(self) -> float | str:
        """The penalty as files state it: a number, or text where it differs between sequences."""
        if self.penalty is None:
            return self.penalty_source
        if self.prismatic_penalty is None:
            return self.penalty
        prismatic = f"{self.prismatic_penalty:g} {self.prismatic_unit} prismatic"
        return f"{self.penalty:g} {self.revolute_unit} revolute, {prismatic}"


@dataclass(frozen=True)
class Measured:
    """The values of one answer."""

    values: dict[str, float | None]
    """Metric id to value in the metric's unit. None: not defined for this sequence (no query shows the object). A
    missing id: the answer has nothing to measure (no surface, another joint type), which is penalised."""
    swapped: bool
    """Whether the answer's moving part was matched to the true reference part."""
    other_views: bool = False
    """Whether the renders were those for the other choice of reference part (`renders_other`)."""
    notes: tuple[str, ...] = ()
    """Remarks for the row."""


@dataclass(frozen=True)
class Shape:
    """The surfaces of an answer's two parts in its canonical frame, and the motion of its moving part."""

    parts: tuple[Mesh, Mesh]
    """Reference and moving part at state zero."""
    motions: Array
    """(n, 4, 4) displacement of the moving part from state zero in every frame."""

    def moved(self, T_new_canonical: Array) -> "Shape":
        """The same shape in another canonical frame."""
        T = T_new_canonical
        reference, moving = (part.moved(T) for part in self.parts)
        return Shape((reference, moving), T @ self.motions @ se3.inverse(T))

    def swapped(self) -> "Shape":
        """The same shape with the names of its parts exchanged."""
        return Shape(self.parts[::-1], se3.inverse(self.motions))


@dataclass(frozen=True)
class Case:
    """An answer to one sequence, and the truth that it is measured against. A protocol reads what it needs."""

    truth: Truth
    answer: Reconstruction
    """With as many frames as the truth, and masks of its size."""
    renders: Sequence[Render]
    """One for each held-out query."""
    asset: Shape | None = None
    """The shape of its asset in the answer's canonical frame; None without an asset."""
    renders_other: Sequence[Render] | None = None
    """The renders for the other choice of reference part; None when there are none at all."""
    lacks: tuple[Piece, ...] = ()
    """Pieces that the method never makes: metrics that need one get meaningless values."""


@dataclass(frozen=True)
class Protocol:
    """A named, versioned set of metrics."""

    name: str
    preamble: str
    """How parts are matched, poses aligned, lengths scaled, failures counted."""
    metrics: tuple[Metric, ...]
    measure: Callable[[Case], Measured]
    """The values in the units of the metrics."""
    asset: Literal["none", "joint", "whole"]
    """What is measured of an answer's asset: nothing, its joint, or its meshes and masses, too (and then also renders
    for both choices of the reference part)."""
    capped: bool = False
    """Whether the penalty caps the value, so that no answer costs more than a declared failure."""
    ranking: bool = False
    """Whether methods are ranked by it."""
    sequence_penalties: Callable[[Truth], dict[str, float | None]] = lambda truth: {}
    """Metric id to penalty for metrics whose penalty depends on the sequence; None where there is no value."""
    published: tuple[PublishedRow, ...] = ()
    """Values published by others for other objects by these definitions: shown for comparison, never ranked."""

    def penalties(self, truth: Truth) -> dict[str, float | None]:
        """Metric id to penalty, in the metric's unit for this sequence; None where there is no value."""
        kind, from_sequence = truth.articulation.joint.type, self.sequence_penalties(truth)
        return {metric.id: metric.penalty_for(kind, from_sequence.get(metric.id)) for metric in self.metrics}

    @property
    def penalised_by_truth(self) -> tuple[str, ...]:
        """Ids of the metrics whose penalty reveals a number of the truth, such as its range of motion."""
        return tuple(metric.id for metric in self.metrics if metric.penalty is None)

    def capped_value(self, id: str, value: float, penalty: float) -> float:
        """`value` of the metric `id`, or its penalty when that is better and the protocol caps values."""
        if not self.capped:
            return value
        return min(value, penalty) if self.metric(id).direction == "down" else max(value, penalty)

    def metric(self, id: str) -> Metric:
        """The metric `id`; FreeArtError lists the known ones."""
        for metric in self.metrics:
            if metric.id == id:
                return metric
        raise FreeArtError(f"unknown metric '{id}'; metrics of {self.name}: {', '.join(m.id for m in self.metrics)}")


def to_floats(values: dict[str, float | None]) -> dict[str, float | None]:
    """`values` as Python floats."""
    return {id: None if value is None else float(value) for id, value in values.items()}
