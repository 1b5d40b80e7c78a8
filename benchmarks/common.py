"""Shared by all benchmarks: command line, report files, tables, rows that are kept, commands within limits."""

from __future__ import annotations

import hashlib
import math
import os
import platform
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd
import tyro

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
SHARED = ROOT.parent / "shared"
"""Data of others, where they are at hand; nothing of them enters the repository."""
NAMED = ("freeart21", "numpy", "numba", "opencv-python-headless", "sapien", "mujoco")
"""Packages whose versions a report states."""
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
    """Write the JSON file of a benchmark: `body`, `settings`, commit, date, machine and versions. Prints its path."""
    atomic.write_json(path, {**body, **made_with(), "settings": settings})
    print(path)


def made_with() -> dict[str, Any]:
    """Commit, day (UTC), machine and versions that a figure was measured with."""
    day = datetime.now(timezone.utc).date().isoformat()
    return {"commit": commit(), "date": day, "machine": machine(), "versions": {name: version(name) for name in NAMED}}


def print_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table of texts and numbers on standard output."""
    table = pd.DataFrame([list(map(str, row)) for row in rows], columns=list(head))
    print(f"\n{title}\n{table.to_string(index=False, max_colwidth=90)}" if len(table) else f"\n{title}: no rows")


def format_number(value: float | int | None, digits: int = 3) -> str:
    """A number with so many decimals; '-' for None."""
    return "-" if value is None else f"{value:.{digits}f}"


def keep_row(file: Path, key: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The row in `file` when it has this key; else a new one, kept there unless it is {"crash": reason}."""
    known = checked.read_json(file) if file.is_file() else {}
    if known.get("key") == key:
        return dict(known["row"])
    row = make()
    if "crash" not in row:
        atomic.write_json(file, {"key": key, "row": row})
    return row


def run_rows(
    folder: Path, todo: Mapping[str, tuple[str, Callable[..., dict[str, Any]], tuple[Any, ...]]], workers: int = 1
) -> dict[str, dict[str, Any]]:
    """Rows by name, of key, function and arguments by name: each made in a process of its own, `workers` side by side.

    A row is kept in `folder` as long as its key holds, so that a run that was stopped goes on. What fails gives
    {"crash": reason}, and is tried again by the next run.
    """

    def run(call: Callable[..., dict[str, Any]], given: tuple[Any, ...]) -> dict[str, Any]:
        try:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
                return process.submit(call, *given).result()
        except Exception as error:  # whatever it died of is the row's, not the others'
            return {"crash": f"{type(error).__name__}: {error}"}

    def make(name: str) -> dict[str, Any]:
        key, call, given = todo[name]
        row = keep_row(folder / f"{name}.json", key, lambda: run(call, given))
        print(f"{name}: {row.get('crash', 'known')}", file=sys.stderr, flush=True)
        return row

    with ThreadPoolExecutor(workers) as pool:
        return dict(zip(todo, pool.map(make, todo), strict=True))


def digest_of(*facts: object, files: Iterable[Path] = ()) -> str:
    """SHA-256, hexadecimal, of facts and of the names and bytes of files: the key of a kept row."""
    digest = hashlib.sha256(repr(facts).encode())
    for file in files:
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()


def commit(*places: str) -> str:
    """The last commit that changed `places` (all but results when none are named), '-dirty' when they differ from it.

    'unknown' outside git.
    """

    def run_git(*command: str) -> str:
        where = places or (".", ":!benchmarks/results")
        words = ["git", *command, "--", *where]
        return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    name = run_git("log", "-1", "--format=%h")
    changed = run_git("status", "--porcelain", "--untracked-files=no")
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
