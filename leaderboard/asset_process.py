"""Loads each asset in a process of its own, without the 1.5 s in which Python imports a simulator.

A server process imports everything once and forks a child for each request. Every child starts from the same state, so
a crash, a leak or an endless loop affects its own request only.
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
"""Seconds after a request's limit in which the server has to report the timeout."""
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
"""Environment of parallel processes that work on small matrices."""
LOG = "output.txt"
_LOG_TAIL_BYTES = 4096
_CHUNK_BYTES = 1 << 16

Reply = Callable[[dict[str, Any]], dict[str, Any]]


class TimedOut(Exception):
    """A request took more than its limit."""


class Crashed(Exception):
    """A request ended its process without an answer; the text has the exit code and the last line of output."""


@dataclass
class _Server:
    process: subprocess.Popen[bytes]
    command: list[str]
    owner: int
    """Id of the process that started it; a fork of that process has to start its own."""


_lock = threading.Lock()
_server: _Server | None = None


def ask(module: str, request: dict[str, Any], folder: Path, limit_s: float) -> dict[str, Any]:
    """`reply(request)` of `module`, computed in a process of its own within `limit_s` seconds.

    `main()` of `module` has to call `serve(reply, ...)`. The process may write to `folder`, which also gets its
    temporary files. Raises TimedOut or Crashed.
    """
    body = json.dumps({"request": request, "folder": str(folder), "limit_s": limit_s}).encode() + b"\n"
    with _lock:
        server = _start(child.command(module))
        try:
            line = _exchange(server.process, body, limit_s + GRACE_S)
        except BaseException:
            _close()
            raise
        if not line:
            _close()
            raise Crashed(f"exit code {server.process.returncode}: no message")
    answer: dict[str, Any] = json.loads(line)
    if "timed_out" in answer:
        raise TimedOut
    if "crashed" in answer:
        raise Crashed(f"exit code {answer['crashed']}: {_last_line(folder / LOG)}")
    reply: dict[str, Any] = answer["answer"]
    return reply


def _start(command: list[str]) -> _Server:
    """The server for `command`, started when it does not run."""
    global _server
    if _server is not None and _server.owner != os.getpid():
        _server = None
    if _server is not None and (_server.command != command or _server.process.poll() is not None):
        _close()
    if _server is None:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env={**os.environ, **ONE_THREAD}
        )
        _server = _Server(process, command, os.getpid())
    return _server


def _exchange(process: subprocess.Popen[bytes], body: bytes, limit_s: float) -> bytes:
    """The answer to `body`; empty when the server has ended or does not answer in time."""
    assert process.stdin is not None and process.stdout is not None
    try:
        unsent = memoryview(body)
        while unsent:
            unsent = unsent[process.stdin.write(unsent) :]
    except BrokenPipeError:
        return b""
    deadline, answer = time.monotonic() + limit_s, b""
    while not answer.endswith(b"\n"):
        ready = select.select([process.stdout], [], [], max(deadline - time.monotonic(), 0))[0]
        chunk = process.stdout.read(_CHUNK_BYTES) if ready else b""
        if not chunk:
            return b""
        answer += chunk
    return answer


def _close() -> None:
    """End the server and its child: both end when its standard input closes."""
    global _server
    if _server is None or _server.owner != os.getpid():
        return
    process, _server = _server.process, None
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
            file.seek(max(path.stat().st_size - _LOG_TAIL_BYTES, 0))
            lines = file.read().decode(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return lines[-1] if lines else "no message"


# ---- the server


def take_streams() -> tuple[int, int]:
    """File descriptors of standard input and output, for requests and answers alone.

    From then on standard input of this process is empty, and what it prints goes to standard error.
    """
    reading, writing = os.dup(0), os.dup(1)
    with open(os.devnull) as nothing:  # noqa: PTH123 (a device)
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    return reading, writing


def serve(reply: Reply, modules: tuple[str, ...]) -> None:
    """Answer the requests on standard input, each in a forked child, after importing `modules` where installed.

    Where forking is not safe (all but Linux), the server itself answers one request and ends.
    """
    reading, answers = take_streams()
    requests = os.fdopen(reading, "rb")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to end
    for name in modules:
        with contextlib.suppress(Exception):  # code that needs a missing module reports it
            importlib.import_module(name)
    while line := requests.readline():
        job = json.loads(line)
        if sys.platform != "linux":
            _write(answers, {"answer": reply(job["request"])})
            return
        answer = _answer_in_child(job, reply, requests.fileno())
        if answer is None:
            return
        _write(answers, answer)


def _answer_in_child(job: dict[str, Any], reply: Reply, parent: int) -> dict[str, Any] | None:
    """The answer of a forked child; None when the parent has closed the descriptor `parent`."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            _run_child(job, reply, writing)
        finally:
            os._exit(70)
    os.close(writing)
    try:
        deadline, answer = time.monotonic() + job["limit_s"], b""
        while True:
            ready = select.select([reading, parent], [], [], max(deadline - time.monotonic(), 0))[0]
            if parent in ready or not ready:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                return None if ready else {"timed_out": True}
            if not (chunk := os.read(reading, _CHUNK_BYTES)):
                break
            answer += chunk
    finally:
        os.close(reading)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return {"crashed": code} if code or not answer else json.loads(answer)


def _run_child(job: dict[str, Any], reply: Reply, writing: int) -> None:
    log = os.open(Path(job["folder"]) / LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.environ["TMPDIR"] = tempfile.tempdir = job["folder"]  # the parent removes it, however the child ends
    _write(writing, {"answer": reply(job["request"])})
    os._exit(0)  # the simulator's teardown can crash


def _write(descriptor: int, answer: dict[str, Any]) -> None:
    unsent = memoryview(json.dumps(answer).encode() + b"\n")
    while unsent:
        unsent = unsent[os.write(descriptor, unsent) :]
