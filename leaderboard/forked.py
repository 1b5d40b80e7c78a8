"""Answers each request in a process of its own, without the 1.5 s in which Python imports a simulator.

A server process imports everything once and forks a child for each request. Every child starts from the same state, so
a crash, a leak or an endless loop affects its own request only. A child that has to ask in turn forks directly.
"""

from __future__ import annotations

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
from pathlib import Path
from typing import Any

from freeart21 import processes

GRACE_S = 30.0
"""Seconds after a request's limit in which the server has to report the timeout."""
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
"""Environment of parallel processes that work on small matrices."""
LOG = "output.txt"
_LOG_TAIL_BYTES = 4096
_CHUNK_BYTES = 1 << 16
_is_forked = False
"""Whether this process is a server's child, which has imported what its own requests need."""

Reply = Callable[[dict[str, Any]], dict[str, Any]]


class TimedOut(Exception):
    """A request took more than its limit."""


class Crashed(Exception):
    """A request ended its process without an answer; the text has the exit code and the last line of output."""


class Server:
    """Owner of the server process of `module`, whose `reply` answers and whose `main()` calls `serve(reply, ...)`."""

    def __init__(self, module: str) -> None:
        self._module = module
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0  # id of the process that started it; a fork of that process starts its own
        self._lock = threading.Lock()
        self._ended = False

    def ask(self, request: dict[str, Any], folder: Path, limit_s: float) -> dict[str, Any]:
        """`reply(request)`, computed in a process of its own within `limit_s` seconds.

        The process may write to `folder`, which also gets its temporary files. Raises TimedOut or Crashed.
        """
        job = {"request": request, "folder": str(folder), "limit_s": limit_s}
        if _is_forked:
            answer = _answer_in_child(job, importlib.import_module(self._module).reply, None)
            assert answer is not None  # there is no parent to go
        else:
            answer = self._ask_process(job)
        if "timed_out" in answer:
            raise TimedOut
        if "crashed" in answer:
            raise Crashed(f"exit code {answer['crashed']}: {_last_line(folder / LOG)}")
        reply: dict[str, Any] = answer["answer"]
        return reply

    def end(self) -> None:
        """End the server for good, also while another thread waits for its answer, which gets Crashed."""
        self._ended = True
        if (process := self._process) is not None and process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()

    def close(self) -> None:
        """End the process and its child: both end when its standard input closes."""
        process, self._process = self._process, None
        if process is None or self._owner != os.getpid():
            return
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _ask_process(self, job: dict[str, Any]) -> dict[str, Any]:
        body = json.dumps(job).encode() + b"\n"
        with self._lock:
            process = self._start()
            try:
                line = _exchange(process, body, job["limit_s"] + GRACE_S)
            except BaseException:
                self.close()
                raise
            if not line:
                self.close()
                raise Crashed(f"exit code {process.returncode}: no message")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _start(self) -> subprocess.Popen[bytes]:
        """The running process, started when there is none."""
        if self._ended:
            raise Crashed("exit code 0: stopped")
        if self._process is not None and (self._owner != os.getpid() or self._process.poll() is not None):
            self.close()
        if self._process is None:
            self._owner = os.getpid()
            self._process = subprocess.Popen(
                processes.command(self._module),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                env={**os.environ, **ONE_THREAD},
                start_new_session=True,  # signals of the terminal do not reach it: its owner decides when to end
            )
        return self._process


def _exchange(process: subprocess.Popen[bytes], body: bytes, limit_s: float) -> bytes:
    """The answer to `body`; empty when the server has ended or does not answer in time."""
    assert process.stdin is not None and process.stdout is not None
    try:
        unsent = memoryview(body)
        while unsent:
            unsent = unsent[process.stdin.write(unsent) :]
    except (BrokenPipeError, ValueError):  # ended, or its pipe closed by `end`
        return b""
    deadline, answer = time.monotonic() + limit_s, b""
    while not answer.endswith(b"\n"):
        ready = select.select([process.stdout], [], [], max(deadline - time.monotonic(), 0))[0]
        chunk = process.stdout.read(_CHUNK_BYTES) if ready else b""
        if not chunk:
            return b""
        answer += chunk
    return answer


def _last_line(path: Path) -> str:
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - _LOG_TAIL_BYTES, 0))
            lines = file.read().decode(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return lines[-1] if lines else "no message"


# ---- the server


def serve(reply: Reply, modules: tuple[str, ...]) -> None:
    """Answer the requests on standard input, each in a forked child, after importing `modules` where installed.

    Ends when standard input closes. Where forking is not safe (all but Linux), the server itself answers one request.
    """
    requests, answers = os.fdopen(os.dup(0), "rb"), os.dup(1)
    with open(os.devnull) as nothing:  # noqa: PTH123 (a device)
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)  # what is printed is no answer
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


def _answer_in_child(job: dict[str, Any], reply: Reply, parent: int | None) -> dict[str, Any] | None:
    """The answer of a forked child; None when the descriptor `parent` was closed at its other end meanwhile."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reading)
            _run_child(job, reply, writing)
        finally:
            os._exit(70)
    os.close(writing)
    waited_for = [reading] if parent is None else [reading, parent]
    try:
        deadline, answer = time.monotonic() + job["limit_s"], b""
        while True:
            ready = select.select(waited_for, [], [], max(deadline - time.monotonic(), 0))[0]
            if parent in ready or not ready:
                _kill_group(pid)
                os.waitpid(pid, 0)
                return None if ready else {"timed_out": True}
            if not (chunk := os.read(reading, _CHUNK_BYTES)):
                break
            answer += chunk
    finally:
        os.close(reading)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return {"crashed": code} if code or not answer else json.loads(answer)


def _kill_group(pid: int) -> None:
    """Kill a child and what it has forked in turn."""
    for kill in (os.killpg, os.kill):  # the second for a child that has no group of its own yet
        with contextlib.suppress(ProcessLookupError):
            kill(pid, signal.SIGKILL)


def _run_child(job: dict[str, Any], reply: Reply, writing: int) -> None:
    global _is_forked
    if not _is_forked:  # a child's child stays in its group, and ends with it
        os.setpgid(0, 0)
    _is_forked = True
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
