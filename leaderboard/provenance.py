"""Provenance of scores: hashes of results and truths, and the code, libraries and machine that made the numbers."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import stat
import subprocess
from dataclasses import replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import freeart21
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import Benchmark
from freeart21.files.hashes import file_sha256
from leaderboard.rows import Scores
from leaderboard.submission import MAX_FILES

MAX_BYTES = 4 << 30
"""Largest folder that is hashed; a result of 300 frames has 20 MB."""
LIBRARIES = ("numpy", "scipy", "scikit-image", "sapien", "numba", "opencv-python-headless", "trimesh")
_ROOT = Path(__file__).resolve().parents[1]


def describe_environment() -> dict[str, Any]:
    """Version of the package, commit, and versions of Python and libraries, and the machine.

    The commit is empty outside a checkout and ends in '-dirty' when files differ from it.
    """
    return {
        "freeart21": freeart21.__version__,
        "commit": _commit(),
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in LIBRARIES},
        "machine": {"system": platform.system(), "machine": platform.machine(), "processor": _processor()},
    }


def folder_sha256(folder: Path) -> str:
    """SHA-256 (hexadecimal) of the names and bytes of all files in `folder`; links count by their target's name.

    Raises FreeArtError when it is not a folder, cannot be read, or has more than MAX_FILES files or MAX_BYTES bytes.
    """
    if folder.is_symlink() or not folder.is_dir():
        raise FreeArtError(f"{folder} is not a folder")
    entries, bytes_left = [], MAX_BYTES
    try:
        for place, folders, files in os.walk(folder, onerror=_raise):
            for name in (*folders, *files):
                path = Path(place) / name
                found = path.lstat()
                if stat.S_ISDIR(found.st_mode):
                    continue
                if stat.S_ISLNK(found.st_mode):
                    content = f"link {path.readlink()}"
                elif stat.S_ISREG(found.st_mode):
                    bytes_left -= found.st_size
                    if bytes_left < 0:
                        raise FreeArtError(f"{folder} has more than {MAX_BYTES} bytes")
                    content = file_sha256(path)
                else:
                    content = "neither file nor folder"
                entries.append((path.relative_to(folder).as_posix(), content))
                if len(entries) > MAX_FILES:
                    raise FreeArtError(f"{folder} has more than {MAX_FILES} files")
    except OSError as error:
        raise FreeArtError(f"cannot read {folder}: {error.strerror}") from error
    return hashlib.sha256(json.dumps(sorted(entries)).encode()).hexdigest()


def sha256_or_none(folder: Path) -> str | None:
    """`folder_sha256`, or None when that raises."""
    try:
        return folder_sha256(folder)
    except FreeArtError:
        return None


def truth_sha256(benchmark: Benchmark, sequence: str) -> str | None:
    """Hash of a sequence's truth folder; salted for a hidden truth, so that nobody can confirm a guess by it."""
    found = sha256_or_none(benchmark.truth(sequence))
    return hashlib.sha256(f"{benchmark.salt} {found}".encode()).hexdigest() if found and benchmark.salt else found


def with_provenance(scores: Scores, results: Path, benchmark: Benchmark) -> Scores:
    """`scores` with the environment and the hash of every result and truth added.

    Paths in reasons and notes become relative to the results folder, so that the table is the same wherever it lies.
    """
    prefixes = tuple(f"{place}/" for place in dict.fromkeys((Path(results).resolve(), Path(results))))

    def relative(text: str) -> str:
        for prefix in prefixes:
            text = text.replace(prefix, "")
        return text

    rows = tuple(
        replace(
            row,
            reason=relative(row.reason),
            notes=tuple(relative(note) for note in row.notes),
            result_sha256=sha256_or_none(Path(results) / row.sequence),
            truth_sha256=truth_sha256(benchmark, row.sequence),
        )
        for row in scores.rows
    )
    return replace(scores, rows=rows, made_with=describe_environment())


def _raise(error: OSError) -> None:
    raise error


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:  # OpenCV goes by several names
        return ""


@lru_cache
def _processor() -> str:
    """Name of the processor from /proc/cpuinfo, else from `platform`."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


@lru_cache
def _commit() -> str:
    """Commit of the checkout that holds this package; empty outside a checkout or without git."""
    if not (_ROOT / ".git").exists():
        return ""
    command = ["git", "-C", str(_ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
