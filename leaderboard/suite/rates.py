"""Cost of a suite's jobs per frame of video, by kind of job: measured rates, updated by the suite's own jobs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked

SCHEMA = "freeart21/suite-rates/1"
MEASURED = Path(__file__).with_name("rates.json")
"""The rates that a new suite's forecast uses."""


@dataclass(frozen=True)
class Rate:
    """Cost of one kind of job."""

    seconds_per_frame: float
    """Of one worker: CPU seconds, or wall seconds where `source` says so."""
    bytes_per_frame: float
    """Written to the disk."""
    source: str
    """Where both were measured."""


def read_rates(path: Path = MEASURED) -> dict[str, Rate]:
    """Kind of job to its rate. Raises FreeArtError when the file holds none."""
    data = checked.read_json(path, SCHEMA, checked.ANYWHERE).get("rates")
    try:
        return {str(kind): Rate(**rate) for kind, rate in dict(data or {}).items()}
    except (TypeError, ValueError) as error:
        raise FreeArtError(f"{path}: 'rates' is not a rate (seconds, bytes, source) for every kind of job") from error


def update_rates(rates: dict[str, Rate], finished: Iterable[tuple[str, float, int]], source: str) -> dict[str, Rate]:
    """`rates` with the seconds of the `finished` jobs (kind, seconds, frames) where there are any of a kind."""
    sums: dict[str, tuple[float, int, int]] = {}
    for kind, seconds, frames in finished:
        total, n, jobs = sums.get(kind, (0.0, 0, 0))
        sums[kind] = total + seconds, n + frames, jobs + 1
    return {
        kind: Rate(sums[kind][0] / sums[kind][1], rate.bytes_per_frame, f"{source}: {sums[kind][2]} jobs")
        if kind in sums and sums[kind][1]
        else rate
        for kind, rate in rates.items()
    }


def write_rates(path: Path, rates: dict[str, Rate]) -> None:
    """Write `rates` as `read_rates` reads them."""
    atomic.write_json(path, {"schema": SCHEMA, "rates": {kind: asdict(rate) for kind, rate in rates.items()}})
