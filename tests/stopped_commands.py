"""Long commands that are asked to stop (Ctrl-C) at some moment, and what that leaves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def start(arguments: list[str], out: Path) -> subprocess.Popen[str]:
    """A command in a session of its own, with its temporary files in out/tmp."""
    (out / "tmp").mkdir(parents=True, exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "freeart21", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(out / "tmp")},
        cwd=out,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )


def of_session(session: int) -> list[str]:
    """The command lines of the processes of a session that live."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, here = stat.read_text().rpartition(")")[2].split()[:4]
            if int(here) == session and state != "Z":
                found.append((stat.parent / "cmdline").read_text().replace("\0", " ")[:100])
        except OSError:
            continue
    return found


def left_running(session: int, patience_s: float = 3.0) -> list[str]:
    """What lives of a session when it has had a moment to end."""
    for _ in range(int(patience_s / 0.1)):
        if not of_session(session):
            break
        time.sleep(0.1)
    return of_session(session)


def left_half_written(out: Path) -> list[str]:
    """Files and folders left half-written: but for what a recording is to go on from."""
    return [
        str(path.relative_to(out))
        for path in out.rglob("*")
        if ".recording" not in path.parts
        and path != out / "tmp"
        and (path.name.endswith((".part", ".old", ".lock")) or (out / "tmp") in path.parents)
    ]


def stop(arguments: list[str], out: Path, files: int, to_all: bool, twice: bool) -> tuple[int, list[str]]:
    """Exit code of a command that is asked to stop once it has written `files` files, and what was wrong.

    `to_all`: the signal goes to all of its processes, as from a terminal, not to the command alone; `twice`: it comes
    again a moment later.
    """
    running, wrong = start(arguments, out), []
    tell = os.killpg if to_all else os.kill
    while (
        running.poll() is None
        and sum(len(names) for place, _, names in os.walk(out) if place != str(out / "tmp")) < files
    ):
        time.sleep(0.01)
    is_stopped = running.poll() is None
    for _ in range(1 + twice):
        if running.poll() is None:
            tell(running.pid, signal.SIGINT)
        time.sleep(0.1 * twice)
    try:
        _, errors = running.communicate(timeout=90)
    except subprocess.TimeoutExpired:
        wrong.append("did not end")
        os.killpg(running.pid, signal.SIGKILL)
        _, errors = running.communicate()
    lines = [line for line in errors.splitlines() if line.strip()]
    if running.returncode == 130 and (len(lines) != 1 or not lines[0].startswith("freeart21: stopped")):
        wrong.append(f"not one line: {errors[-2000:]}")
    if running.returncode not in ((130, 0) if is_stopped else (0,)):  # it may have been done when it was asked
        wrong.append(f"exit code {running.returncode}: {errors[-2000:]}")
    if left := left_running(running.pid):
        wrong.append(f"left running: {left}")
        os.killpg(running.pid, signal.SIGKILL)
    return running.returncode, wrong + [f"left: {name}" for name in left_half_written(out)]
