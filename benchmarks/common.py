"""Shared by all benchmarks: command line, report files, tables, keys of cached rows, commands within limits."""

from __future__ import annotations

import hashlib
import math
import os
import platform
import resource
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from freeart21.errors import FreeArtError
from freeart21.files import atomic

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PATIENCE = 8.0
"""Times its limit that a command may take by the clock: a busy machine gives it a part of a processor."""


def run_cli(main: Callable[..., int | None]) -> None:
    """Run the benchmark `main` with the options of the command line, and exit; errors are one line."""
    try:
        raise SystemExit(tyro.cli(main))
    except FreeArtError as error:
        raise SystemExit(f"{Path(main.__code__.co_filename).stem}: {error}") from error
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def write_report(path: Path, settings: dict[str, Any], **body: Any) -> None:
    """Write the JSON file of a benchmark: `body`, `settings`, the commit and the machine. Prints its path."""
    atomic.write_json(path, {**body, "commit": commit(), "machine": machine(), "settings": settings})
    print(path)


def wide_console(width: int = 170) -> Console:
    """Standard output, wide enough for the tables."""
    console = Console()
    if not console.is_terminal:
        console.width = width
    return console


def make_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]], texts: Sequence[str] = ()) -> Table:
    """A table without styles. The first column and those named in `texts` are left-aligned, all others right."""
    table = Table(title=title or None)
    for k, name in enumerate(head):
        table.add_column(name, justify="left" if k == 0 or name in texts else "right")
    for row in rows:
        table.add_row(*map(str, row))
    return table


def format_number(value: float | int | None, digits: int = 3) -> str:
    """A number with so many decimals; '-' for None."""
    return "-" if value is None else f"{value:.{digits}f}"


def digest_of(*facts: object, files: Iterable[Path] = ()) -> str:
    """SHA-256, hexadecimal, of facts and of the names and bytes of files: the key of a cached row."""
    digest = hashlib.sha256(repr(facts).encode())
    for file in files:
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()


def code_of(*places: str) -> list[Path]:
    """The Python files of folders or files of the repository."""
    return [path for place in places for path in sorted((ROOT / place).rglob("*.py")) or [ROOT / place]]


def commit() -> str:
    """The commit that is checked out, with '-dirty' when tracked files differ from it, its results apart.

    'unknown' outside git.
    """

    def run_git(*command: str) -> str:
        return subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    name = run_git("describe", "--always", "--exclude", "*")
    changed = run_git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!benchmarks/results")
    return f"{name}-dirty" if name and changed else name or "unknown"


def machine() -> dict[str, Any]:
    """Processor, cores and Python of this machine."""
    return {"processor": _processor(), "cores": os.cpu_count(), "python": platform.python_version()}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, None when it was killed, the last line that it wrote, and its time."""

    code: int | None
    last: str
    seconds: float
    """Of processor time, with its children's."""
    wall_seconds: float


def run_within(limit: float, command: Sequence[str], folder: Path) -> Ended:
    """Run a command in a folder; it and its children are killed after `limit` seconds of processor time each, or
    PATIENCE times that by the clock."""
    began, most = time.monotonic(), math.ceil(limit)
    with (folder / "output.txt").open("w+b") as output:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (most, most))
        clock = threading.Timer(PATIENCE * limit, os.killpg, (process.pid, signal.SIGKILL))
        clock.start()
        _, status, used = os.wait4(process.pid, 0)
        clock.cancel()
        output.seek(0)
        lines = output.read().decode(errors="replace").strip().splitlines() or [""]
    process.returncode = code = os.waitstatus_to_exitcode(status)
    seconds, wall = round(used.ru_utime + used.ru_stime, 1), round(time.monotonic() - began, 1)
    return Ended(None if code in (-signal.SIGXCPU, -signal.SIGKILL) else code, lines[-1], seconds, wall)
