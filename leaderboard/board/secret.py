"""Data and truths of a board, from folders, archives and addresses; encryption by openssl.

An archive is encrypted by `openssl enc` with a passphrase (OPTIONS). It is not authenticated by that: the digest in the
public half's benchmark.json is the check of a truth, the signed ledger that of a table.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import checked
from leaderboard.archive import MAX_ARCHIVE_BYTES, open_results
from leaderboard.board.settings import TRUTH_KEY

OPTIONS = ("-aes-256-cbc", "-pbkdf2", "-iter", "600000", "-md", "sha256", "-salt")
"""Of `openssl enc`. 600,000 rounds: OWASP's advice for PBKDF2 with SHA-256 (2023)."""
SCHEMES = ("https://",)
ENCRYPTED = ".enc"
"""End of the name of an encrypted file."""
_TIMEOUT_S = 60


@contextlib.contextmanager
def open_place(given: str, board: Path, work: Path, what: str) -> Iterator[Path]:
    """The folder that `given` names: a folder, a ZIP, an encrypted ZIP (NAME.zip.enc), or the address of a ZIP.

    Paths are relative to `board`; `work` is an empty folder for what is fetched, decrypted and unpacked. Raises
    FreeArtError, which names `what` and never an address, which can hold a token.
    """
    if given.startswith(("http:", "https:")):
        name = "fetched.zip" + ENCRYPTED * given.partition("?")[0].endswith(ENCRYPTED)
        path = fetch(given, work / name, MAX_ARCHIVE_BYTES, what)
    else:
        path = board / given
    if path.name.endswith(ENCRYPTED):
        clear = work / path.name.removesuffix(ENCRYPTED)
        crypt(path, clear, decrypt=True)
        path = clear
    if not path.exists():
        raise FreeArtError(f"{what}: {path.name} is not there")
    with open_results(path) as folder:
        yield folder


def fetch(address: str, path: Path, limit: int, what: str) -> Path:
    """`path`, with the content of an https address of at most `limit` bytes. Raises FreeArtError."""
    if not address.startswith(SCHEMES):
        raise FreeArtError(f"{what}: its address does not begin with {' or '.join(SCHEMES)}")
    try:
        with urllib.request.urlopen(address, timeout=_TIMEOUT_S) as answer, path.open("xb") as file:
            if not str(answer.url).startswith(SCHEMES):
                raise FreeArtError(f"{what}: its address leads to one that does not begin with {SCHEMES[0]}")
            while piece := answer.read(1 << 20):
                file.write(piece)
                if file.tell() > limit:
                    raise FreeArtError(f"{what}: its address has more than {limit} bytes")
    except (OSError, ValueError, urllib.error.URLError) as error:
        raise FreeArtError(f"{what}: cannot be fetched: {type(error).__name__}") from error
    return path


def crypt(source: Path, target: Path, decrypt: bool = False) -> None:
    """Encrypt or decrypt a file with the passphrase in the environment. Raises FreeArtError."""
    if not os.environ.get(TRUTH_KEY):
        raise FreeArtError(f"{TRUTH_KEY} is not set, expected the passphrase of {source.name}")
    checked.require_file(source, MAX_ARCHIVE_BYTES, checked.ANYWHERE)
    way = ["-d"] if decrypt else []
    command = ["openssl", "enc", *way, *OPTIONS, "-pass", f"env:{TRUTH_KEY}", "-in", str(source), "-out", str(target)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=3600)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FreeArtError(f"cannot run openssl: {error}") from error
    if done.returncode:
        target.unlink(missing_ok=True)
        raise FreeArtError(f"{source.name} cannot be {'de' if decrypt else 'en'}crypted by openssl with {TRUTH_KEY}")
