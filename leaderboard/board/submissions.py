"""What lies in submissions/PHASE/METHOD/: a folder of results, a ZIP of them, or NAME.json with a ZIP's address."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.hashes import file_sha256
from freeart21.files.result import Method
from leaderboard.archive import open_results
from leaderboard.board.ledger import Ledger
from leaderboard.board.secret import fetch
from leaderboard.board.settings import NAME, BoardSettings
from leaderboard.method_names import check_name, looks_of
from leaderboard.provenance import folder_sha256
from leaderboard.reference import is_reference
from leaderboard.submission import escape_unprintable

FOLDER = "submissions"
SCHEMA = "freeart21/board-submission/1"
WEEK = timedelta(days=7)
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Submission:
    """One submission in the repository."""

    phase: str
    method: str
    name: str
    path: Path

    @property
    def place(self) -> str:
        """Where it lies, relative to the board."""
        return f"{FOLDER}/{self.phase}/{self.method}/{self.name}"


def find_submissions(board: Path) -> list[Submission]:
    """All submissions, by place. What has another place or another kind of name is no submission: `check` names it."""
    found = []
    for path in sorted((board / FOLDER).glob("*/*/*")):
        phase, method = path.parts[-3:-1]
        name = path.name if path.is_dir() else path.stem
        plain = all(NAME.fullmatch(word) for word in (phase, method, name))
        if plain and (path.is_dir() or path.suffix in (".zip", ".json")):
            found.append(Submission(phase, method, name, path))
    return found


@contextlib.contextmanager
def open_submission(given: Submission, board: Path, settings: BoardSettings, work: Path) -> Iterator[tuple[Path, str]]:
    """The results folder of a submission, and its SHA-256; `work` is an empty folder. Raises FreeArtError."""
    limit = settings.limits.megabytes * 1_000_000
    path = checked.require_inside(board / FOLDER, given.path)
    if path.is_symlink():
        raise FreeArtError(f"{given.place} is a link, expected the file itself")
    if path.suffix == ".json" and path.is_file():
        data = checked.read_json(path, SCHEMA)
        expected = checked.text(data, "sha256", path)
        if not _SHA256.fullmatch(expected):
            raise FreeArtError(f"{given.place}: 'sha256' is {checked.shorten(expected)}, expected 64 digits")
        path = fetch(checked.text(data, "url", path), work / f"{given.name}.zip", limit, given.place)
        if file_sha256(path, checked.ANYWHERE) != expected:
            raise FreeArtError(f"{given.place}: what its address has is not the file of its 'sha256'")
    if path.is_file():
        size = path.stat().st_size
        digest = file_sha256(path, checked.ANYWHERE) if size <= limit else ""
    else:
        size = sum(file.lstat().st_size for file in path.rglob("*"))
        digest = folder_sha256(path) if size <= limit else ""
    if size > limit:
        raise FreeArtError(f"{given.place} has {size / 1e6:.0f} MB, at most {settings.limits.megabytes} are taken")
    with open_results(path) as folder:
        yield folder, digest


def check_method(given: Submission, method: Method) -> None:
    """Raise FreeArtError where a method's name is reserved, not that of its folder, or claims to be a reference row."""
    if is_reference(method):
        raise FreeArtError(f"{given.place}: its method.json says that it is made from the truth")
    check_name(method, given.place)
    if looks_of(method.name) != looks_of(given.method):
        raise FreeArtError(
            f"{given.place}: its method is named '{escape_unprintable(method.name)}', expected the name of its folder, "
            f"'{given.method}', but for case, spaces and punctuation"
        )


def check_folder(given: Submission, others: set[str]) -> None:
    """Raise FreeArtError where the folder's name is easily confused with another method's."""
    for other in sorted(others - {given.method}):
        if looks_of(other) == looks_of(given.method):
            raise FreeArtError(f"{given.place}: '{given.method}' looks like '{other}', which is another method's name")


def count_of_week(ledger: Ledger, given: Submission, now: datetime) -> int:
    """Submissions of this method and phase that were received in the seven days before `now`."""
    return sum(
        entry.method == given.method
        and entry.phase == given.phase
        and now - WEEK < datetime.fromisoformat(entry.received) <= now
        for entry in ledger.entries
    )
