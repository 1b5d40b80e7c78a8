"""A process for each asset, without the second and a half that a Python takes to import a simulator.

A Python that has imported everything waits for requests and forks one child for each: the child begins where any other
begins, so a crash, a leak or a loop without end is its own, and the next asset finds nothing of it.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freeart21 import child

GRACE_S = 30.0
"""Seconds beyond a request's limit that the waiting process gets to say so."""
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
"""Environment of processes that work on small matrices side by side: more threads would only wait for each other."""
SAID = "said.txt"
_LONGEST_SAID = 4096


class TimedOut(Exception):
    """A request took more than its limit."""


class Crashed(Exception):
    """A request ended the process that answered it; the text says how."""


@dataclass
class _Waiting:
    """The Python that waits, and whose it is."""

    process: subprocess.Popen[bytes]
    command: list[str]
    owner: int
    """Process id of who started it: a fork of that one has to start its own."""


_lock = threading.Lock()
_waiting: _Waiting | None = None


def ask(module: str, request: dict[str, Any], place: Path, limit_s: float) -> dict[str, Any]:
    """What `reply(request)` of `module` says, asked in a process of its own within `limit_s` seconds.

    The `main()` of `module` runs `serve(reply, ...)` here.
    `place` is a folder where the process may write; its temporary files go there. Raises TimedOut or Crashed.
    """
    body = json.dumps({"request": request, "place": str(place), "limit_s": limit_s}).encode() + b"\n"
    with _lock:
        waiting = _running(child.command(module))
        try:
            line = _line(waiting.process, body, limit_s + GRACE_S)
        except BaseException:
            _close()
            raise
        if not line:
            _close()
            raise Crashed(f"exit code {waiting.process.returncode}: no message")
    answer: dict[str, Any] = json.loads(line)
    if "late" in answer:
        raise TimedOut
    if "ended" in answer:
        raise Crashed(f"exit code {answer['ended']}: {_last_line(place / SAID)}")
    said: dict[str, Any] = answer["answer"]
    return said


def _running(command: list[str]) -> _Waiting:
    global _waiting
    if _waiting is not None and _waiting.owner != os.getpid():
        _waiting = None
    if _waiting is not None and (_waiting.command != command or _waiting.process.poll() is not None):
        _close()
    if _waiting is None:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env={**os.environ, **ONE_THREAD}
        )
        _waiting = _Waiting(process, command, os.getpid())
    return _waiting


def _line(process: subprocess.Popen[bytes], body: bytes, limit_s: float) -> bytes:
    """The answer to `body`; empty when the process has ended, or does not answer at all."""
    assert process.stdin is not None and process.stdout is not None
    try:
        left = memoryview(body)
        while left:
            left = left[process.stdin.write(left) :]
    except BrokenPipeError:
        return b""
    deadline, answer = time.monotonic() + limit_s, b""
    while not answer.endswith(b"\n"):
        ready = select.select([process.stdout], [], [], max(deadline - time.monotonic(), 0))[0]
        some = process.stdout.read(1 << 16) if ready else b""
        if not some:
            return b""
        answer += some
    return answer


def _close() -> None:
    """End the waiting process, and the child that it may have: without its input it ends both."""
    global _waiting
    if _waiting is None or _waiting.owner != os.getpid():
        return
    process, _waiting = _waiting.process, None
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


atexit.register(_close)


def _last_line(path: Path) -> str:
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - _LONGEST_SAID, 0))
            lines = file.read().decode(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return lines[-1] if lines else "no message"


# ---- what waits


def serve(reply: Callable[[dict[str, Any]], dict[str, Any]], needed: tuple[str, ...]) -> None:
    """Answer the requests on standard input, each in a child of which the modules `needed` are imported, until it ends.

    Where a process cannot be forked safely (all but Linux) the one that waits answers itself, once.
    """
    requests, answers = os.fdopen(os.dup(0), "rb"), os.dup(1)
    with open(os.devnull) as nothing:  # noqa: PTH123 (a device)
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent says when to end
    for name in needed:
        with contextlib.suppress(Exception):  # who cannot do without it says so
            importlib.import_module(name)
    while line := requests.readline():
        asked = json.loads(line)
        if sys.platform != "linux":
            _write(answers, {"answer": reply(asked["request"])})
            return
        answer = _apart(asked, reply, requests.fileno())
        if answer is None:
            return
        _write(answers, answer)


def _apart(
    asked: dict[str, Any], reply: Callable[[dict[str, Any]], dict[str, Any]], parent: int
) -> dict[str, Any] | None:
    """The answer of a child; None when `parent`, who asked, is gone."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            _be_child(asked, reply, writing)
        finally:
            os._exit(70)
    os.close(writing)
    try:
        deadline, answer = time.monotonic() + asked["limit_s"], b""
        while True:
            ready = select.select([reading, parent], [], [], max(deadline - time.monotonic(), 0))[0]
            if parent in ready or not ready:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                return None if ready else {"late": True}
            if not (some := os.read(reading, 1 << 16)):
                break
            answer += some
    finally:
        os.close(reading)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return {"ended": code} if code or not answer else json.loads(answer)


def _be_child(asked: dict[str, Any], reply: Callable[[dict[str, Any]], dict[str, Any]], writing: int) -> None:
    said = os.open(Path(asked["place"]) / SAID, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(said, 1)
    os.dup2(said, 2)
    os.environ["TMPDIR"] = tempfile.tempdir = asked["place"]  # what it leaves there goes, however it ends
    _write(writing, {"answer": reply(asked["request"])})
    os._exit(0)  # without the simulator's teardown


def _write(place: int, answer: dict[str, Any]) -> None:
    left = memoryview(json.dumps(answer).encode() + b"\n")
    while left:
        left = left[os.write(place, left) :]
