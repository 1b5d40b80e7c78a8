"""The ledger of a board: every submission, the hashes of its tables, and all places, in one file that is signed.

It is signed by ssh-keygen (`-Y sign`), which every machine with git has; who may sign is in keys/allowed_signers.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.hashes import file_sha256
from freeart21.files.json_record import read_record
from leaderboard.board.settings import SIGNING_KEY, BoardSettings

SCHEMA = "freeart21/board-ledger/1"
FILE, SIGNATURE, SIGNERS = "ledger.json", "ledger.json.sig", "keys/allowed_signers"
NAMESPACE = "freeart21-board"
"""Of the signature: one made for another purpose does not pass."""


@dataclass(frozen=True)
class Entry:
    """A submission that the board has received."""

    phase: str
    method: str
    """Its folder's name."""
    submission: str
    sha256: str
    received: str
    """When it was first seen: UTC, ISO 8601. What its author says about time is not believed."""
    status: Literal["scored", "refused"]
    reason: str
    """Why it was refused; empty for a scored one."""
    isolation: str
    """What it was scored in."""
    files: dict[str, str]
    """Table, relative to the board, to its SHA-256."""


@dataclass(frozen=True)
class Places:
    """The places in one phase by one protocol, from a time on."""

    time: str
    phase: str
    protocol: str
    tracks: dict[str, dict[str, tuple[float | None, ...]]]
    """Track to method's folder to points and place."""


@dataclass(frozen=True)
class Ledger:
    """Content of ledger.json."""

    entries: tuple[Entry, ...] = ()
    history: tuple[Places, ...] = field(default=())
    """Only times at which something changed."""

    def find(self, phase: str, method: str, submission: str) -> Entry | None:
        """The entry of a submission, if it has been received."""
        key = (phase, method, submission)
        return next((e for e in self.entries if (e.phase, e.method, e.submission) == key), None)

    def with_entry(self, entry: Entry) -> Ledger:
        """The ledger with this entry added, or in place of the one of the same submission."""
        old = self.find(entry.phase, entry.method, entry.submission)
        if old is None:
            return replace(self, entries=(*self.entries, entry))
        return replace(self, entries=tuple(entry if e is old else e for e in self.entries))

    def current(self, phase: str) -> dict[str, Entry]:
        """Method's folder to its newest scored submission: that one counts, not the best."""
        return {e.method: e for e in self.entries if e.phase == phase and e.status == "scored"}


def read_ledger(folder: Path) -> Ledger:
    """The ledger of the board in `folder`, empty where nothing was scored yet. Raises FreeArtError."""
    path = Path(folder) / FILE
    if not checked.is_there(path):
        return Ledger()
    data: dict[str, Any] = checked.read_json(path, SCHEMA)
    return read_record(Ledger, {key: value for key, value in data.items() if key != "schema"}, str(path), whole=True)


def write_ledger(folder: Path, ledger: Ledger, settings: BoardSettings) -> None:
    """Write the ledger and its signature by the key in the environment. Raises FreeArtError."""
    text = atomic.json_text({"schema": SCHEMA, **asdict(ledger)}).encode()
    with _signing_key() as key, tempfile.TemporaryDirectory() as work:
        file = Path(work) / FILE
        file.write_bytes(text)
        _ssh_keygen("sign", "-f", str(key), str(file))
        signature = Path(work, SIGNATURE).read_bytes()
    _verify(folder, settings, text, signature)
    atomic.write_bytes(folder / FILE, text)
    atomic.write_bytes(folder / SIGNATURE, signature)


def verify_board(folder: Path, settings: BoardSettings) -> list[str]:
    """What is wrong with the ledger's signature and the tables: a line each, empty when nothing."""
    folder = Path(folder)
    if not checked.is_there(folder / FILE):
        stray = sorted((folder / "tables").rglob("*.json")) if (folder / "tables").is_dir() else []
        return [f"{folder} has tables and no {FILE}"] if stray else []
    signature = checked.read_bytes(folder / SIGNATURE, checked.MAX_JSON_BYTES)
    try:
        _verify(folder, settings, checked.read_bytes(folder / FILE, checked.MAX_JSON_BYTES), signature)
    except FreeArtError as error:
        return [str(error)]
    listed = {name: digest for entry in read_ledger(folder).entries for name, digest in entry.files.items()}
    faults = []
    for name, digest in sorted(listed.items()):
        if not (folder / name).is_file():
            faults.append(f"{folder / name} is missing: the ledger lists it")
        elif file_sha256(checked.inside(folder, name)) != digest:
            faults.append(f"{folder / name} is not the table that was signed")
    here = {p.relative_to(folder).as_posix() for p in (folder / "tables").rglob("*") if not p.is_dir()}
    return faults + [f"{folder / name} is not in the ledger" for name in sorted(here - set(listed))]


def make_key(path: Path, signer: str) -> str:
    """Make the private SSH key `path`; gives its line of keys/allowed_signers. Raises FreeArtError."""
    with tempfile.TemporaryDirectory() as work:
        key = Path(work) / "key"
        _run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", signer, "-f", str(key)])
        public = key.with_suffix(".pub").read_text().split()
        atomic.write_bytes(path, key.read_bytes(), mode=0o600)
    return f'{signer} namespaces="{NAMESPACE}" {public[0]} {public[1]}\n'


def _verify(folder: Path, settings: BoardSettings, text: bytes, signature: bytes) -> None:
    signers = checked.require_file(folder / SIGNERS, checked.MAX_JSON_BYTES, folder)
    with tempfile.TemporaryDirectory() as work:
        file = Path(work) / SIGNATURE
        file.write_bytes(signature)
        try:
            _ssh_keygen("verify", "-f", str(signers), "-I", settings.signer, "-s", str(file), given=text)
        except FreeArtError as error:
            raise FreeArtError(f"{folder / FILE} is not signed by {settings.signer} as in {signers}") from error


def require_signing_key() -> None:
    """Raise FreeArtError where the environment has no private key."""
    with _signing_key():
        pass


@contextlib.contextmanager
def _signing_key() -> Iterator[Path]:
    """The private key as a file that only its owner reads."""
    given = os.environ.get(SIGNING_KEY, "")
    if not given:
        raise FreeArtError(f"{SIGNING_KEY} is not set, expected the private key that `freeart21 board init` made")
    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / "key"
        text = given if "PRIVATE KEY" in given else checked.read_text(Path(given), 1 << 16, checked.ANYWHERE)
        atomic.write_bytes(path, (text.replace("\r\n", "\n").rstrip("\n") + "\n").encode(), mode=0o600)
        yield path


def _ssh_keygen(what: str, *options: str, given: bytes = b"") -> None:
    _run(["ssh-keygen", "-q", "-Y", what, "-n", NAMESPACE, *options], given)


def _run(command: list[str], given: bytes = b"") -> None:
    try:
        done = subprocess.run(command, input=given, capture_output=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FreeArtError(f"cannot run {command[0]}: {error}; it comes with OpenSSH") from error
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines() or [f"exit code {done.returncode}"]
        raise FreeArtError(f"{command[0]}: {lines[0]}")
