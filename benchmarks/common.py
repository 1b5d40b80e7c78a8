"""What all benchmarks say of themselves: from which commit, on which machine. And how they run what may not end."""

from __future__ import annotations

import math
import os
import platform
import resource
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PATIENCE = 8.0
"""Times its limit that a command may take by the clock: a busy machine gives it a part of a processor."""


def commit() -> str:
    """The commit that is checked out, with '-dirty' when tracked files differ from it, its results apart.

    'unknown' outside git.
    """

    def said(*command: str) -> str:
        return subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    name = said("describe", "--always", "--exclude", "*")
    changed = said("status", "--porcelain", "--untracked-files=no", "--", ".", ":!benchmarks/results")
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
