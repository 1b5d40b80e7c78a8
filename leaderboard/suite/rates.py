"""What a job takes, by its kind, a frame of video: from measured rates, and then from what this suite has measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked

SCHEMA = "freeart21/suite-rates/1"
MEASURED = Path(__file__).with_name("rates.json")
"""The one place of the rates that a forecast begins with."""


@dataclass(frozen=True)
class Rate:
    """Of one kind of job."""

    seconds_per_frame: float
    """Of one worker: CPU seconds, or wall seconds where `source` says so."""
    bytes_per_frame: float
    """What it leaves on the disk."""
    source: str
    """Where these were measured."""


def read_rates(path: Path = MEASURED) -> dict[str, Rate]:
    """Kind of job to its rate; FreeArtError when the file holds none."""
    data = checked.read_json(path, SCHEMA, checked.ANYWHERE).get("rates")
    try:
        return {str(kind): Rate(**rate) for kind, rate in dict(data or {}).items()}
    except (TypeError, ValueError) as error:
        raise FreeArtError(f"{path}: 'rates' is not a rate (seconds, bytes, source) for every kind of job") from error


def update_rates(rates: dict[str, Rate], taken: Iterable[tuple[str, float, int]], where: str) -> dict[str, Rate]:
    """`rates` with the seconds of those kinds that `taken` (kind, seconds, frames) tells; `where` names the source."""
    sums: dict[str, tuple[float, int, int]] = {}
    for kind, seconds, frames in taken:
        total, n, jobs = sums.get(kind, (0.0, 0, 0))
        sums[kind] = total + seconds, n + frames, jobs + 1
    return {
        kind: Rate(sums[kind][0] / sums[kind][1], rate.bytes_per_frame, f"{where}: {sums[kind][2]} jobs")
        if kind in sums and sums[kind][1]
        else rate
        for kind, rate in rates.items()
    }


def write_rates(path: Path, rates: dict[str, Rate]) -> None:
    """Write `rates` as `read_rates` reads them."""
    atomic.write_json(path, {"schema": SCHEMA, "rates": {kind: asdict(rate) for kind, rate in rates.items()}})
