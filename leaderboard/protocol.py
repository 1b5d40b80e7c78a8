"""What a protocol is: named numbers with a unit, a direction and a price, and the one function that measures them.

The protocols themselves are in `leaderboard.protocols`, one file each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.joint import JointType
from freeart21.mesh import Mesh
from freeart21.reconstruction import Piece
from freeart21.se3 import Array
from freeart21.truth import Truth
from leaderboard.published import PublishedRow

Group = Literal["revolute", "prismatic", "all"]
Render = NDArray[np.uint8] | None
"""The answer's picture (height, width, 3) of one held-out query; None where it has none."""


@dataclass(frozen=True)
class Metric:
    """One number of a protocol."""

    id: str
    revolute_unit: str | None
    """Unit for objects whose true joint is revolute; None where the number does not exist. '%' is of the diagonal."""
    prismatic_unit: str | None
    """Unit for objects whose true joint is prismatic; None where the number does not exist. '%' is of the diagonal."""
    direction: Literal["up", "down"]
    """'up': larger is better."""
    penalty: float | None
    """What a failure, a missing sequence or (where it applies) a wrong joint type costs; None: it depends on the
    sequence, as `penalty_source` says."""
    definition: str
    supplements: str | None = None
    """The ranking number beside which this one is shown; None when it is a ranking number itself."""
    label: str = ""
    """Its name for people, such as 'chamfer, moving part'."""
    column: str = ""
    """The head of its column where tables have room for few; empty: left out there."""
    needs: tuple[Piece, ...] = ()
    """Pieces of an answer without which there is no such number: None in every row of a method that lacks one."""
    prismatic_penalty: float | None = None
    """The price where the true joint is prismatic, if it is another than `price`."""
    penalty_source: str = "range of motion"
    """Where the price comes from when it depends on the sequence."""

    def unit(self, group: Group) -> str | None:
        """The unit in a group of sequences; None where there is none, or no common one."""
        if group == "revolute":
            return self.revolute_unit
        if group == "prismatic":
            return self.prismatic_unit
        if None in (self.revolute_unit, self.prismatic_unit):
            return self.revolute_unit or self.prismatic_unit
        return self.revolute_unit if self.revolute_unit == self.prismatic_unit else None

    def penalty_for(self, joint_type: JointType, from_sequence: float | None = None) -> float | None:
        """The price for a sequence, in the metric's unit; `from_sequence` where it depends on the sequence."""
        if self.unit(joint_type) is None:
            return None
        if joint_type == "prismatic" and self.prismatic_penalty is not None:
            return self.prismatic_penalty
        return from_sequence if self.penalty is None else self.penalty

    @property
    def penalty_text(self) -> float | str:
        """The price as a file says it: the number, or in words where there is not one number for all sequences."""
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
    """Metric id to value in the metric's unit. None: the sequence has no such number (no query shows the object). An id
    that is missing: the answer has nothing to measure (no surface, another joint type), which the protocol prices."""
    swapped: bool
    """Whether the answer's moving part was matched to the true reference part."""
    other_views: bool = False
    """Whether the pictures were those of the other choice of reference part (`renders_other`)."""
    notes: tuple[str, ...] = ()
    """What the reader of the row should know."""


@dataclass(frozen=True)
class Shape:
    """What an answer's two parts look like, in its canonical frame, and how its moving part goes."""

    parts: tuple[Mesh, Mesh]
    """Reference and moving part at state zero."""
    motions: Array
    """(n, 4, 4) displacement of the moving part from state zero in every frame."""

    def moved(self, T_new_canonical: Array) -> Shape:
        """The same shape written in another canonical frame."""
        T = T_new_canonical
        reference, moving = (part.moved(T) for part in self.parts)
        return Shape((reference, moving), T @ self.motions @ se3.inverse(T))

    def swapped(self) -> Shape:
        """The same shape with the names of its parts exchanged."""
        return Shape(self.parts[::-1], se3.inverse(self.motions))


def no_penalties(truth: Truth) -> dict[str, float | None]:
    """None: every price of the protocol is a constant."""
    return {}


@dataclass(frozen=True)
class Protocol:
    """A named, versioned set of metrics."""

    name: str
    preamble: str
    """How parts are matched, poses aligned, lengths scaled, failures counted."""
    metrics: tuple[Metric, ...]
    measure: Callable[..., Measured]
    """`measure(truth, answer, renders, asset=None, renders_other=None, constants=None, lacks=())`, see
    `leaderboard.protocols.strict2.measure`: values in the units of the metrics."""
    asset: Literal["none", "joint", "whole"]
    """What of an answer's asset counts: nothing, its joint, or its meshes and masses too (and then also views under
    both choices of the reference part)."""
    capped: bool = False
    """Whether a price is a cap, so that no answer costs more than a declared failure."""
    ranking: bool = False
    """Whether methods are ranked by it."""
    sequence_penalties: Callable[[Truth], dict[str, float | None]] = no_penalties
    """Metric id to price for those whose price depends on the sequence; None where it has no such number."""
    published: tuple[PublishedRow, ...] = ()
    """What others printed by these definitions, of other objects: shown beside, never ranked."""

    def penalties(self, truth: Truth) -> dict[str, float | None]:
        """Metric id to price, in the metric's unit for this sequence; None for numbers that do not exist for it."""
        kind, from_sequence = truth.articulation.joint.type, self.sequence_penalties(truth)
        return {metric.id: metric.penalty_for(kind, from_sequence.get(metric.id)) for metric in self.metrics}

    @property
    def penalised_by_truth(self) -> tuple[str, ...]:
        """Ids of the metrics whose price is a number of the truth, such as its range of motion."""
        return tuple(metric.id for metric in self.metrics if metric.penalty is None)

    def capped_value(self, id: str, value: float, price: float) -> float:
        """`value` of the metric `id`, or its price where the protocol caps it and the value is worse."""
        if not self.capped:
            return value
        return min(value, price) if self.metric(id).direction == "down" else max(value, price)

    def metric(self, id: str) -> Metric:
        """The metric `id`; FreeArtError lists the known ones."""
        for metric in self.metrics:
            if metric.id == id:
                return metric
        raise FreeArtError(f"unknown metric '{id}'; metrics of {self.name}: {', '.join(m.id for m in self.metrics)}")


def to_floats(values: dict[str, float | None]) -> dict[str, float | None]:
    """`values` as Python's own numbers."""
    return {id: None if value is None else float(value) for id, value in values.items()}
