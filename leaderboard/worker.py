"""Rows scored one after another in a process of their own, each with a limit of time and memory.

What a method hands in may be slow beyond measure (a mesh of a million slivers ran for 480 s) or crash native code: it
then costs its own row. The process is kept between rows, and replaced when one had to be ended.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freeart21 import child
from freeart21.errors import FreeArtError
from leaderboard import asset_process
from leaderboard.rows import Row

ROW_LIMIT_S = 180.0
"""Seconds that a row may take: ours (60 frames, 2 parts of 200k faces, an asset beside) took 18 to 40 on two cores that
six other programs were using."""
ROW_MEMORY = 12 << 30
"""Bytes of address space that a row's process may have: ours have 1.2 GiB."""


class RowAborted(Exception):
    """A row took more than its limit, or ended the process that scored it."""


class Worker:
    """One process that scores rows; closing it ends the process and what it has started."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._over = False

    def score(self, request: dict[str, Any], limit_s: float) -> Row:
        """The row that `leaderboard.sequence_score.score_sequence` makes of `request` (its arguments as JSON has them).

        Raises RowAborted when it takes more than `limit_s` seconds or ends the process, FreeArtError as it does.
        """
        process = self._running()
        assert process.stdin is not None and process.stdout is not None
        timer = threading.Timer(limit_s, _kill, [process])
        timer.start()
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = _answer_line(process)
        except BrokenPipeError:
            line = ""
        finally:
            late = not timer.is_alive()
            timer.cancel()
        if not line:
            code = process.wait()
            self.close()
            raise RowAborted(
                f"scoring took more than {limit_s:g} s" if late else f"scoring ended with exit code {code}"
            )
        if late:  # it answered as it was ended
            self.close()
        said: dict[str, Any] = json.loads(line)
        if "error" in said:
            raise FreeArtError(said["error"])
        if "ended" in said:
            raise RowAborted(said["ended"])
        return Row.from_json(said["row"])

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None:
            self._process = subprocess.Popen(
                child.command("leaderboard.worker"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, **asset_process.ONE_THREAD},
                start_new_session=True,  # it and the simulator that it starts are ended together, and by us alone
            )
        if self._over:
            _kill(self._process)
            raise RowAborted("scoring was stopped")
        return self._process

    def end(self) -> None:
        """End the process for good; a thread that waits for its answer sees it ended. Any thread may call this."""
        self._over = True
        if (process := self._process) is not None:
            _kill(process)

    def close(self) -> None:
        """End the process, and give back what it holds here."""
        if self._process is not None:
            _kill(self._process)
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()
            self._process = None


@contextmanager
def worker() -> Iterator[Worker]:
    """A worker that is gone when the block ends, however it ends."""
    made = Worker()
    try:
        yield made
    finally:
        made.close()


def _kill(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


_MARK = "freeart21-row "


def _answer_line(process: subprocess.Popen[str]) -> str:
    """The JSON of the next answer, whatever native code prints between; empty when the process has ended."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(_MARK):
            return line.removeprefix(_MARK)
    return ""


def main() -> None:
    """Score what standard input asks for, line by line, until it ends: with the parent, whatever becomes of that."""
    requests, answers = _own_streams()
    _limit_memory()
    lines: list[str | None] = []
    ready = threading.Semaphore(0)

    def listen() -> None:
        for line in requests:
            lines.append(line)
            ready.release()
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpid(), signal.SIGKILL)  # the parent is gone: so is whatever runs here
        os._exit(1)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        ready.acquire()
        print("\n" + _MARK + json.dumps(_answer(json.loads(lines.pop(0) or ""))), file=answers, flush=True)


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    from leaderboard.sequence_score import score_sequence

    result, sequence, truth = (Path(request[key]) for key in ("result", "sequence", "truth"))
    try:
        row = score_sequence(result, sequence, truth, request["protocol"], tuple(request["lacks"]))
        return {"row": asdict(row)}
    except FreeArtError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"ended": f"scoring took more than {ROW_MEMORY >> 30} GiB of memory"}
    except Exception as error:  # one result's fault, or ours: the other rows are still due
        return {"ended": f"scoring stopped: {type(error).__name__}: {child.one_line(error)}"}


def _own_streams() -> tuple[Any, Any]:
    """Streams of the parent's pipes that nobody else in this process reads or prints to."""
    requests, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    with open(os.devnull) as nothing:  # noqa: PTH123 (a device)
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    return requests, answers


def _limit_memory() -> None:
    if sys.platform == "linux":
        import resource

        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        limit = ROW_MEMORY if hard == resource.RLIM_INFINITY else min(ROW_MEMORY, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
