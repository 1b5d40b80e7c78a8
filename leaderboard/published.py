"""Tables that others printed, as data: set beside ours as published, never ranked with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class PublishedRow:
    """One line of a printed table: a method over all objects of a data set whose joint is of one type."""

    method: str
    protocol: str
    """The protocol of ours whose definitions come nearest to those that the numbers were computed by."""
    dataset: str
    """What it was measured on: other objects than ours."""
    group: Literal["revolute", "prismatic", "all"]
    values: dict[str, tuple[float, float | None]]
    """Metric id of the protocol to mean and sample standard deviation (None: not printed), in the printed unit."""
    source: str
    """Where it was printed."""
