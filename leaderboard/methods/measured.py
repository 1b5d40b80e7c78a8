"""A command within limits of time and memory, and what it took."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

PERIOD_S = 0.2
"""Between two looks at the memory."""
MAX_LOG = 1 << 20
"""Bytes of a command's output above which its beginning is dropped, at every look."""


@dataclass(frozen=True)
class Usage:
    """What a command took, and how it ended."""

    code: int | None
    """Exit code, negative for a signal; None when it was stopped at a limit."""
    seconds: float
    """By the clock."""
    cpu_seconds: float
    """Of all its processes that it waited for; of a container's client alone."""
    peak_bytes: int
    """Largest sum of resident memory of all its processes, or largest of one of them: looked up every PERIOD_S."""
    stopped_by: str
    """The limit, in words; empty when none was met."""


def run_measured(
    words: list[str], folder: Path, log: Path, seconds: float, memory_bytes: float, stop: Callable[[], None]
) -> Usage:
    """Run the program words[0] with the arguments words[1:] in `folder`; its output goes to `log`.

    Its session is killed, and `stop` called, at a limit or when this process is interrupted. FileNotFoundError and
    PermissionError when it cannot be started.
    """
    began = time.monotonic()
    stopped_by, peak = "", 0
    with log.open("ab") as output:
        process = subprocess.Popen(
            words, cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
        )
    try:
        while True:
            ended, status, used = os.wait4(process.pid, os.WNOHANG)
            _shorten(log)
            if ended:
                break
            peak = max(peak, _resident_bytes(process.pid))
            if time.monotonic() - began > seconds:
                stopped_by = f"it took more than {seconds:g} s"
            elif peak > memory_bytes:
                stopped_by = f"it took more than {memory_bytes / 1e9:g} GB of memory"
            if stopped_by:
                _kill(process.pid)
                stop()
                _, status, used = os.wait4(process.pid, 0)
                break
            time.sleep(PERIOD_S)
    except BaseException:
        _kill(process.pid)
        stop()
        os.wait4(process.pid, 0)
        process.returncode = -signal.SIGKILL
        raise
    _kill(process.pid)  # what it left behind in its session
    process.returncode = os.waitstatus_to_exitcode(status)
    code = None if stopped_by else process.returncode
    return Usage(code, time.monotonic() - began, used.ru_utime + used.ru_stime, peak, stopped_by)


def _shorten(log: Path) -> None:
    """Keep the last half of MAX_LOG bytes of a log that is larger: the command, which appends to it, goes on there."""
    if log.stat().st_size > MAX_LOG:
        with log.open("rb+") as file:
            file.seek(-MAX_LOG // 2, os.SEEK_END)
            end = file.read()
            file.seek(0)
            file.write(end)
            file.truncate()


def _kill(session: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(session, signal.SIGKILL)


def _resident_bytes(session: int) -> int:
    """Resident memory of all processes of a session together, or the largest that one of them has had since its start.

    Pages that they share are counted in each. (`ru_maxrss` counts the memory of the process that started it, too.)
    """
    total, largest = 0, 0
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, KeyError):
            if os.getsid(int(folder.name)) == session:
                lines = (folder / "status").read_text(errors="replace").splitlines()
                facts = dict(line.split(":", 1) for line in lines if line.startswith(("VmHWM:", "VmRSS:")))
                total += int(facts["VmRSS"].split()[0]) * 1024
                largest = max(largest, int(facts["VmHWM"].split()[0]) * 1024)
    return max(total, largest)
