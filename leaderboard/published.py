"""Tables published by others, as data: shown for comparison, never ranked with ours.

They are of other objects and videos, by definitions that the publications leave partly open: see docs/protocols.md. The
numbers are in published.json, copied from the FreeArtGS paper (CVPR 2026, arXiv 2603.22102). Its rows of other methods
on Video2Articulation-S are those methods' own values, in metres, times 100; its mIoUs in percent are fractions here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from freeart21.files import checked

SCHEMA = "freeart21/published/1"
PATH = Path(__file__).with_name("published.json")


@dataclass(frozen=True)
class PublishedRow:
    """One line of a published table: a method over all objects of a data set with joints of one type."""

    method: str
    protocol: str
    """Our protocol with the nearest definitions."""
    dataset: str
    group: Literal["revolute", "prismatic", "all"]
    values: dict[str, tuple[float, float | None]]
    """Metric id of the protocol to mean and sample standard deviation (None: not published), in the metric's unit."""
    source: str
    """Publication and table."""


def _read_rows(path: Path) -> Iterator[PublishedRow]:
    for table in checked.read_json(path, SCHEMA, checked.ANYWHERE)["tables"]:
        for method, cells in table["rows"].items():
            values = {id: tuple(cell) for id, cell in zip(table["metrics"], cells, strict=True) if cell is not None}
            yield PublishedRow(method, table["protocol"], table["dataset"], table["group"], values, table["source"])


PUBLISHED: tuple[PublishedRow, ...] = tuple(_read_rows(PATH))
