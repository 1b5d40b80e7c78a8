"""Answers each request in a process of its own, without the 1.5 s in which Python imports a simulator.

A server process imports everything once and forks a child for each request. Every child starts from the same state, so
a crash, a leak or an endless loop affects its own request only. A child that has to ask in turn forks directly.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from freeart21 import processes

GRACE_S = 30.0
"""Seconds after a request's limit in which the server has to report the timeout."""
PERIOD_S = 0.2
"""Between two looks at whether a server that is waited for was ended."""
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
"""Environment of parallel processes that work on small matrices."""
LOG = "output.txt"
_LOG_TAIL_BYTES = 4096
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
        self._connection: Connection[bytes, bytes] | None = None
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

    def close(self) -> None:
        """End the process and its child: both end when their connection closes."""
        process, self._process = self._process, None
        if process is None or self._connection is None or self._owner != os.getpid():
            return
        self._connection.close()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _ask_process(self, job: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            process, connection = self._start()
            deadline = time.monotonic() + job["limit_s"] + GRACE_S
            try:
                connection.send_bytes(json.dumps(job).encode())
                while not connection.poll(PERIOD_S):
                    if self._ended or time.monotonic() > deadline:
                        raise EOFError
                answer: dict[str, Any] = json.loads(connection.recv_bytes())
            except (EOFError, OSError) as error:
                self.close()
                raise Crashed(f"exit code {process.returncode}: no message") from error
            except BaseException:
                self.close()
                raise
        return answer

    def _start(self) -> tuple[subprocess.Popen[bytes], Connection[bytes, bytes]]:
        """The running process and the connection to it, started when there is none."""
        if self._ended:
            raise Crashed("exit code 0: stopped")
        if self._process is not None and (self._owner != os.getpid() or self._process.poll() is not None):
            self.close()
        if self._process is None:
            self._owner = os.getpid()
            self._connection, other = multiprocessing.Pipe()
            with other:
                self._process = subprocess.Popen(
                    processes.command(self._module),
                    stdin=other.fileno(),
                    env={**os.environ, **ONE_THREAD},
                    start_new_session=True,  # signals of the terminal do not reach it: its owner decides when to end
                )
        assert self._connection is not None
        return self._process, self._connection


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
    """Answer the requests on standard input, a socket, each in a forked child, after importing `modules` if installed.

    Ends when the socket closes. Where forking is not safe (all but Linux), the server itself answers one request.
    """
    parent: Connection[bytes, bytes] = Connection(os.dup(0))
    with open(os.devnull) as nothing:  # noqa: PTH123 (a device)
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)  # what is printed must not reach a user's standard output
    for name in modules:
        with contextlib.suppress(Exception):  # code that needs a missing module reports it
            importlib.import_module(name)
    with contextlib.suppress(EOFError):
        while True:
            job = json.loads(parent.recv_bytes())
            if sys.platform != "linux":
                parent.send_bytes(json.dumps({"answer": reply(job["request"])}).encode())
                return
            answer = _answer_in_child(job, reply, parent)
            if answer is None:
                return
            parent.send_bytes(json.dumps(answer).encode())


def _answer_in_child(job: dict[str, Any], reply: Reply, parent: Connection[Any, Any] | None) -> dict[str, Any] | None:
    """The answer of a forked child; None when the connection `parent` was closed at its other end meanwhile."""
    fork = multiprocessing.get_context("fork")
    reading, writing = fork.Pipe(duplex=False)
    child = fork.Process(target=_run_child, args=(job, reply, writing))
    child.start()
    writing.close()
    ready = wait([reading, *([parent] if parent else [])], job["limit_s"])
    answer = None
    if reading in ready:
        with reading, contextlib.suppress(EOFError):
            answer = {"answer": json.loads(reading.recv_bytes())}
    else:
        for kill in (os.killpg, os.kill):  # with what it has forked; the second if it has no group of its own yet
            with contextlib.suppress(ProcessLookupError):
                kill(child.pid or 0, signal.SIGKILL)
        answer = None if ready else {"timed_out": True}
    child.join()
    return {"crashed": child.exitcode} if reading in ready and answer is None else answer


def _run_child(job: dict[str, Any], reply: Reply, writing: Connection[bytes, bytes]) -> None:
    global _is_forked
    if not _is_forked:  # a child's child stays in its group, and ends with it
        os.setpgid(0, 0)
    _is_forked = True
    log = os.open(Path(job["folder"]) / LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.environ["TMPDIR"] = tempfile.tempdir = job["folder"]  # the parent removes it, however the child ends
    writing.send_bytes(json.dumps(reply(job["request"])).encode())
    os._exit(0)  # the simulator's teardown can crash
