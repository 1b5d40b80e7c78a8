"""A process that scores rows one after another, each within limits of time and memory.

A submission can be too slow (a mesh of a million slivers ran for 480 s) or crash native code; it then costs its own row
only. The process is reused for many rows and replaced when one had to be killed.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freeart21 import child
from freeart21.errors import FreeArtError
from leaderboard import asset_process
from leaderboard.rows import Row

ROW_LIMIT_S = 180.0
"""Time limit of a row. Measured: 18 to 40 s (60 frames, 2 parts of 200k faces, an asset) on two cores shared with six
other programs."""
ROW_MEMORY = 12 << 30
"""Bytes of address space of a row's process. Measured: 1.2 GiB."""
_MARK = "freeart21-row "


class RowAborted(Exception):
    """A row exceeded its limits or crashed the process that scored it; the text says which."""


class Worker:
    """Owner of one scoring process; `close` ends it and everything that it has started."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._ended = False

    def score(self, request: dict[str, Any], limit_s: float) -> Row:
        """The row that `leaderboard.sequence_score.score_sequence` makes of `request` (its arguments as JSON).

        Raises RowAborted when that takes more than `limit_s` seconds or crashes the process, FreeArtError as it does.
        """
        process = self._start()
        assert process.stdin is not None and process.stdout is not None
        timer = threading.Timer(limit_s, _kill, [process])
        timer.start()
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = _read_answer(process)
        except BrokenPipeError:
            line = ""
        finally:
            timed_out = not timer.is_alive()
            timer.cancel()
        if not line:
            code = process.wait()
            self.close()
            reason = f"took more than {limit_s:g} s" if timed_out else f"ended with exit code {code}"
            raise RowAborted(f"scoring {reason}")
        if timed_out:  # it answered just as it was killed
            self.close()
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise FreeArtError(answer["error"])
        if "aborted" in answer:
            raise RowAborted(answer["aborted"])
        return Row.from_json(answer["row"])

    def _start(self) -> subprocess.Popen[str]:
        """The running process, started when there is none."""
        if self._process is None:
            self._process = subprocess.Popen(
                child.command("leaderboard.worker"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, **asset_process.ONE_THREAD},
                start_new_session=True,  # one kill ends it and its simulator; signals of the terminal do not reach it
            )
        if self._ended:
            _kill(self._process)
            raise RowAborted("scoring was stopped")
        return self._process

    def end(self) -> None:
        """Kill the process for good; thread-safe. A thread that waits for its answer gets RowAborted."""
        self._ended = True
        if (process := self._process) is not None:
            _kill(process)

    def close(self) -> None:
        """Kill the process and close its pipes."""
        if self._process is not None:
            _kill(self._process)
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()
            self._process = None


def _kill(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _read_answer(process: subprocess.Popen[str]) -> str:
    """The JSON of the next answer, other output of native code skipped; empty when the process has ended."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(_MARK):
            return line.removeprefix(_MARK)
    return ""


def main() -> None:
    """Score the requests on standard input, one JSON object a line, until it closes: when the parent ends."""
    reading, writing = asset_process.take_streams()
    requests, answers = os.fdopen(reading), os.fdopen(writing, "w")
    _limit_memory()
    lines: list[str] = []
    ready = threading.Semaphore(0)

    def listen() -> None:
        for line in requests:
            lines.append(line)
            ready.release()
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpid(), signal.SIGKILL)  # the parent is gone: end the simulator, too
        os._exit(1)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        ready.acquire()
        print("\n" + _MARK + json.dumps(_answer(json.loads(lines.pop(0)))), file=answers, flush=True)


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    from leaderboard.sequence_score import score_sequence

    result, sequence, truth = (Path(request[key]) for key in ("result", "sequence", "truth"))
    try:
        row = score_sequence(result, sequence, truth, request["protocol"], tuple(request["lacks"]))
        return {"row": asdict(row)}
    except FreeArtError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"aborted": f"scoring took more than {ROW_MEMORY >> 30} GiB of memory"}
    except Exception as error:  # the other rows are still scored
        return {"aborted": f"scoring stopped: {type(error).__name__}: {child.one_line(error)}"}


def _limit_memory() -> None:
    if sys.platform == "linux":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = ROW_MEMORY if hard == resource.RLIM_INFINITY else min(ROW_MEMORY, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
