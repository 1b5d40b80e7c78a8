"""What numbers come from: the code, the libraries and the machine that made them, and the bytes that they are of."""

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
from freeart21.code import code_digest, modules_behind
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import Benchmark
from leaderboard.rows import Scores
from leaderboard.submission import MAX_FILES

MAX_BYTES = 4 << 30
"""Of a result folder that is hashed: ours of 300 frames have 20 MB."""
LIBRARIES = ("numpy", "scipy", "scikit-image", "sapien", "numba", "opencv-python-headless", "trimesh")
_ROOMS = ("freeart21", "generator", "reconstruct", "export", "leaderboard", "simgap")
_ROOT = Path(__file__).resolve().parents[1]
_PIECE = 1 << 20


def describe_environment() -> dict[str, Any]:
    """Version of this package, fingerprint of the code that scores a row, commit (empty outside of a checkout; with
    '-dirty' when files differ from it), versions of what computes, and the machine: the same on the same machine."""
    return {
        "freeart21": freeart21.__version__,
        "scoring": scoring_code(),
        "commit": _commit(),
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in LIBRARIES},
        "machine": {"system": platform.system(), "machine": platform.machine(), "processor": _processor()},
    }


@lru_cache
def scoring_code() -> str:
    """SHA-256, hexadecimal, of what all modules do that scoring a row may use."""
    return code_digest(modules_behind("leaderboard.sequence_score", _ROOT, _ROOMS).items())


def folder_sha256(folder: Path) -> str:
    """SHA-256, hexadecimal, of the names and bytes of all files in `folder`; links are named, and not followed.

    Raises FreeArtError when it is no folder, cannot be read, or has more than MAX_FILES files or MAX_BYTES bytes.
    """
    if folder.is_symlink() or not folder.is_dir():
        raise FreeArtError(f"{folder} is not a folder")
    entries, left = [], MAX_BYTES
    try:
        for place, folders, files in os.walk(folder, onerror=_refuse):
            for name in (*folders, *files):
                path = Path(place) / name
                found = path.lstat()
                if stat.S_ISDIR(found.st_mode):
                    continue
                if stat.S_ISLNK(found.st_mode):
                    said = f"link {path.readlink()}"
                elif stat.S_ISREG(found.st_mode):
                    left -= found.st_size
                    if left < 0:
                        raise FreeArtError(f"{folder} has more than {MAX_BYTES} bytes")
                    said = _file_sha256(path, found.st_size)
                else:
                    said = "neither file nor folder"
                entries.append((path.relative_to(folder).as_posix(), said))
                if len(entries) > MAX_FILES:
                    raise FreeArtError(f"{folder} has more than {MAX_FILES} files")
    except OSError as error:
        raise FreeArtError(f"cannot read {folder}: {error.strerror}") from error
    return hashlib.sha256(json.dumps(sorted(entries)).encode()).hexdigest()


def sha256_or_none(folder: Path) -> str | None:
    """As `folder_sha256`, None where that raises."""
    try:
        return folder_sha256(folder)
    except FreeArtError:
        return None


def truth_sha256(benchmark: Benchmark, sequence: str) -> str | None:
    """The hash of a sequence's truth folder; salted where the truth is hidden, so that no guess can be confirmed."""
    found = sha256_or_none(benchmark.truth(sequence))
    return hashlib.sha256(f"{benchmark.salt} {found}".encode()).hexdigest() if found and benchmark.salt else found


def with_provenance(scores: Scores, results: Path, benchmark: Benchmark) -> Scores:
    """`scores` with what they were made with, and the hash of every result and truth that they are of.

    What rows say names files from the results folder on: it is the same wherever that lies.
    """
    places = tuple(f"{place}/" for place in dict.fromkeys((Path(results).resolve(), Path(results))))

    def placeless(text: str) -> str:
        for place in places:
            text = text.replace(place, "")
        return text

    rows = tuple(
        replace(
            row,
            reason=placeless(row.reason),
            notes=tuple(placeless(note) for note in row.notes),
            result_sha256=sha256_or_none(Path(results) / row.sequence),
            truth_sha256=truth_sha256(benchmark, row.sequence),
        )
        for row in scores.rows
    )
    return replace(scores, rows=rows, made_with=describe_environment())


def _file_sha256(path: Path, size: int) -> str:
    """Of at most `size` bytes: a file that somebody goes on writing has an end."""
    digest = hashlib.sha256()
    with checked.open_file(path, MAX_BYTES) as file:
        while size > 0 and (piece := file.read(min(size, _PIECE))):
            digest.update(piece)
            size -= len(piece)
    return digest.hexdigest()


def _refuse(error: OSError) -> None:
    raise error


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:  # OpenCV goes by several names
        return ""


@lru_cache
def _processor() -> str:
    """The name of the processor where Linux tells it, else what Python knows."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


@lru_cache
def _commit() -> str:
    """Of the checkout that this package lies in; empty when it lies in none of its own, or there is no git."""
    if not (_ROOT / ".git").exists():
        return ""
    asked = ["git", "-C", str(_ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(asked, capture_output=True, text=True, timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
