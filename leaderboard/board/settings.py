"""board.json: what the maintainers of a board decide, and the names of the secrets that it needs."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Literal

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record
from leaderboard.protocols import protocol_named

SCHEMA = "freeart21/board/1"
FILE = "board.json"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,59}")
"""Names of phases, methods' folders and submissions: plain file names on every system."""
DATA, TRUTH = "BOARD_DATA_", "BOARD_TRUTH_"
"""Beginnings of the variables with the place of a phase's public half (in place of that in board.json) and truth."""
TRUTH_KEY, SIGNING_KEY = "BOARD_TRUTH_KEY", "BOARD_SIGNING_KEY"
"""The passphrase of encrypted truths and tables; the private SSH key, as text or as a file's path."""


@dataclass(frozen=True)
class Phase:
    """A time in which answers to one data folder are taken."""

    name: str
    data: str
    """Its public half: a folder or ZIP, relative to the board, or the https address of a ZIP."""
    starts: str
    """Day (UTC), such as 2026-12-01; from its midnight."""
    ends: str | None
    """The last day (UTC) on which submissions are taken; None for no end."""

    def is_open(self, now: datetime) -> bool:
        """Whether submissions are taken at `now` (UTC)."""
        day = now.date().isoformat()
        return self.starts <= day and (self.ends is None or day <= self.ends)

    def variable(self, beginning: str) -> str:
        """The environment variable of this phase."""
        return beginning + re.sub(r"[^A-Z0-9]", "_", self.name.upper())


@dataclass(frozen=True)
class Limits:
    """What a submission may cost."""

    per_week: int
    """Submissions that are scored of one method in seven days and one phase."""
    megabytes: int
    """Size of a submission, packed."""
    minutes: int
    """Time to score a submission by one protocol."""
    memory_gib: int
    """Memory of a container; without one, each row has `leaderboard.worker.ROW_MEMORY`."""


@dataclass(frozen=True)
class BoardSettings:
    """Content of board.json."""

    title: str
    protocols: tuple[str, ...]
    """The first one orders the site. A new one is added here: current submissions are then scored by it, too."""
    phases: tuple[Phase, ...]
    limits: Limits
    isolation: Literal["auto", "container", "process"]
    """auto: a container where docker or podman runs, else a bounded process without network where that is possible."""
    image: str
    """Of the container."""
    signer: str
    """Who signs, as keys/allowed_signers says."""

    def phase(self, name: str) -> Phase | None:
        """The phase of this name, if any."""
        return next((phase for phase in self.phases if phase.name == name), None)


def read_settings(folder: Path) -> BoardSettings:
    """The settings of the board in `folder`. Raises FreeArtError."""
    path = Path(folder) / FILE
    if not checked.is_there(path):
        raise FreeArtError(f"{folder} is not a board: it has no {FILE}; `freeart21 board init` writes one")
    data = checked.read_json(path, SCHEMA)
    settings = read_record(BoardSettings, {k: v for k, v in data.items() if k != "schema"}, str(path), whole=True)
    if not settings.protocols or not settings.phases:
        raise FreeArtError(f"{path}: it has no {'phases' if settings.protocols else 'protocols'}, expected one or more")
    for protocol in settings.protocols:
        protocol_named(protocol)
    for phase in settings.phases:
        if not NAME.fullmatch(phase.name):
            raise FreeArtError(f"{path}: a phase is named {checked.shorten(phase.name)}, expected letters and digits")
        for day in (phase.starts, phase.ends or phase.starts):
            if not _is_day(day):
                raise FreeArtError(
                    f"{path}: phase {phase.name} has the day {checked.shorten(day)}, expected one such as 2026-12-01"
                )
    variables = [phase.variable(TRUTH) for phase in settings.phases]
    if len({*variables, TRUTH_KEY}) <= len(variables):
        raise FreeArtError(f"{path}: two phases have one variable: {', '.join(variables)}; name them otherwise")
    small = [name for name, value in asdict(settings.limits).items() if value < 1]
    if small:
        raise FreeArtError(f"{path}: the limit '{small[0]}' is below 1, expected a whole number from 1 on")
    return settings


def write_settings(folder: Path, settings: BoardSettings) -> None:
    """Write board.json."""
    atomic.write_json(folder / FILE, {"schema": SCHEMA, **asdict(settings)})


def utc_now() -> datetime:
    """The time, UTC, to the second."""
    return datetime.now(timezone.utc).replace(microsecond=0)


def _is_day(text: str) -> bool:
    try:
        return datetime.strptime(text, "%Y-%m-%d").strftime("%Y-%m-%d") == text
    except ValueError:
        return False
