"""One job done, in a process of its own that ends with whoever started it."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import json
import os
import platform
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freeart21 import child, stopping
from freeart21.ending import reason
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.lock import locked
from freeart21.jobs.job import Job, job_from_json
from freeart21.jobs.ledger import Ledger

PATIENCE_S = 15.0
"""How long a job that is told to stop may clear up."""
_FOR_EVER_S = 1e9
_LONGEST_LINE = 500
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "LP_NUM_THREADS")
"""Environment variables that clusters like to set, and on which the last bit of a sum may hang."""


@dataclass(frozen=True)
class Ended:
    """How the process of a job ended. What came of the job stands in its files."""

    name: str
    code: int
    """Exit code; negative: the signal that killed it, or that it was lost with its machine."""
    line: str = ""
    """Its last line on standard error."""


def request(folder: Path, job: Job, digest: str) -> str:
    """What a job's process is asked, as one line of JSON."""
    threads = {name: os.environ.get(name) for name in _THREADS}
    facts = {"folder": str(Path(folder).resolve()), "job": job.to_json(), "digest": digest, "threads": threads}
    return json.dumps(facts)


def start(asked: str) -> subprocess.Popen[str]:
    """The process that does what `asked` says, in a session of its own; it ends when its standard input does."""
    process = subprocess.Popen(
        child.command("freeart21.jobs.work"),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):
        process.stdin.write(asked + "\n")
        process.stdin.flush()
    return process


def ended(name: str, process: subprocess.Popen[str]) -> Ended:
    """How `process` ended; waits for it."""
    assert process.stdin is not None and process.stderr is not None
    said = process.stderr.read()
    code = process.wait()
    if code < 0:  # what it had started may live
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stderr):
        with contextlib.suppress(OSError):
            pipe.close()
    return Ended(name, code, last_line(said))


def in_a_process(name: str, asked: str) -> tuple[str, int, str]:
    """Do what `asked` says in a process of its own, and wait: what a cluster's worker runs. As `Ended`."""
    end = ended(name, start(asked))
    return end.name, end.code, end.line


# --- in the job's own process -----------------------------------------------------------------------------------------


def main() -> None:
    """Do the one job that standard input names; end when that ends: with the parent, whatever becomes of it."""
    stopping.listen()
    asked = json.loads(sys.stdin.readline())

    def end_with_the_parent() -> None:
        while os.read(0, 4096):
            pass
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpid(), signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=end_with_the_parent, daemon=True).start()
    for name, value in asked["threads"].items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
    try:
        do(Path(asked["folder"]), job_from_json(asked["job"]), asked["digest"])
        stopping.check()
    except KeyboardInterrupt:
        sys.exit(128 + (stopping.told() or signal.SIGINT))
    except FreeArtError as error:
        sys.exit(str(error))
    except Exception as error:
        print(f"{type(error).__name__}: {child.one_line(error)}", file=sys.__stderr__, flush=True)
        sys.exit(70)


def do(folder: Path, job: Job, digest: str) -> None:
    """Do `job`, unless it is finished: its output appears whole, then its statistics, its marker last.

    The same job is never done twice at a time: whoever comes second waits, and finds it done. A job that fails has
    statistics and no marker. Raises FreeArtError when its place is taken or the disk refuses.
    """
    ledger = Ledger(folder)
    with locked(ledger.path("running", job.name, ".lock"), f"job '{job.name}' is running elsewhere", _FOR_EVER_S):
        if ledger.finished(job, digest):
            return
        ledger.begin(job)
        out = None if job.out is None else folder / job.out
        if out is not None:
            atomic.mend(out)
            if not job.resumes:
                _clear(out)
        began, before = time.monotonic(), _cpu_s()
        with _aside(out if "{out}" in json.dumps(job.to_json()) else None) as place:
            words = {"{folder}": str(folder), "{python}": sys.executable, "{out}": str(place)}
            code, line, returned = _run(ledger, job, words)
            if code in job.codes and out is not None and place is not None and place.exists():
                stopping.check()
                out.parent.mkdir(parents=True, exist_ok=True)
                if out.exists() and job.resumes:
                    _clear(out)
                place.replace(out)
        good = code in job.codes
        if good and out is not None and not out.exists():
            good, line = False, line or f"it ended with exit code {code} and did not make {job.out}"
        facts = {"good": good, "code": code, "line": line, "returned": returned, "machine": platform.node()}
        seconds = {"seconds": round(time.monotonic() - began, 3), "cpu_seconds": round(_cpu_s() - before, 3)}
        ledger.say(job, digest, **facts, **seconds)
        if good:
            os.sync()  # before the marker, whatever the job has left in the system's memory
            ledger.finish(job, digest)


def _run(ledger: Ledger, job: Job, words: dict[str, str]) -> tuple[int, str, Any]:
    """Exit code, last line of standard error, and what a call returned."""
    logs = [ledger.path("logs", job.name, ending) for ending in (".out.txt", ".err.txt")]
    logs[0].parent.mkdir(parents=True, exist_ok=True)
    returned: Any = None
    with logs[0].open("wb") as out, logs[1].open("wb") as err:
        if job.command:
            argv = [word for given in job.command for word in _word(given, words)]
            code = _command(argv, ledger.folder, out, err)
        else:
            code, returned = _call(job, words, out, err)
    line = _tail(logs[1])
    if code < 0:
        line = f"killed by signal {-code}" + (", for want of memory perhaps" if code == -signal.SIGKILL else "")
    elif code not in job.codes and not line:
        line = f"exit code {code}, and not a word"
    return code, line.removeprefix("freeart21: "), returned


def _word(given: str, words: dict[str, str]) -> list[str]:
    if given == "{freeart21}":
        return child.command("freeart21.__main__")
    return [_filled(given, words)]


def _filled(value: Any, words: dict[str, str]) -> Any:
    if isinstance(value, str):
        for name, word in words.items():
            value = value.replace(name, word)
        return value
    if isinstance(value, dict):
        return {key: _filled(inner, words) for key, inner in value.items()}
    return [_filled(inner, words) for inner in value] if isinstance(value, list | tuple) else value


def _command(argv: list[str], folder: Path, out: Any, err: Any) -> int:
    try:
        process = subprocess.Popen(
            argv, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err, preexec_fn=dies_with_us()
        )
    except OSError as error:
        err.write(f"cannot run {argv[0]}: {reason(error)}\n".encode())
        return 127
    return waited(process)


def dies_with_us() -> Callable[[], None]:
    """What a process that a job starts does first (`preexec_fn`): asks to be killed when this one is.

    The rest of its group ends with this process's standard input; but who kills this process alone, as Ray does with
    the children of its workers and the system for want of memory, would leave it to work on, unseen. Linux only.
    """
    if sys.platform != "linux":
        return lambda: None
    prctl, parent = ctypes.CDLL(None).prctl, os.getpid()

    def ask() -> None:
        prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:
            os._exit(1)

    return ask


def waited(process: subprocess.Popen[bytes]) -> int:
    """The exit code of a process that a job has started, when it has ended.

    Told to stop, it was told with us, as it is of our process group: it has PATIENCE_S to clear up.
    """
    try:
        return process.wait()
    except KeyboardInterrupt:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE_S)
        process.kill()
        process.wait()
        raise


def _call(job: Job, words: dict[str, str], out: Any, err: Any) -> tuple[int, Any]:
    """Exit code and what the function returns; what it prints, native code too, goes to the logs."""
    kept = [os.dup(1), os.dup(2)]
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os.dup2(out.fileno(), 1)
    os.dup2(err.fileno(), 2)
    try:
        module, function = job.call.split(":")
        return 0, getattr(importlib.import_module(module), function)(**_filled(job.arguments, words))
    except FreeArtError as error:
        print(f"freeart21: {error}", file=sys.stderr)
        return 1, None
    except Exception as error:
        if stopping.told():
            raise KeyboardInterrupt from error
        import traceback

        traceback.print_exc()
        print(f"{type(error).__name__}: {child.one_line(error)}", file=sys.stderr)
        return 70, None
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for k, handle in enumerate(kept):
            os.dup2(handle, k + 1)
            os.close(handle)


@contextlib.contextmanager
def _aside(out: Path | None) -> Iterator[Path | None]:
    """A place of the name of `out`, in a hidden folder beside it that goes with the block."""
    if out is None:
        yield None
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        holder = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.", suffix=atomic.ASIDE))
    except OSError as error:
        raise atomic.cannot_write(out, error) from error
    try:
        yield holder / out.name
    finally:
        with stopping.deferred():
            shutil.rmtree(holder, ignore_errors=True)


def _clear(out: Path) -> None:
    """Remove what stands at `out`, which is never seen half removed."""
    if not out.exists() and not out.is_symlink():
        return
    holder = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.", suffix=atomic.ASIDE))
    out.replace(holder / out.name)
    shutil.rmtree(holder, ignore_errors=True)


def _cpu_s() -> float:
    """CPU seconds, user and system, of this process and those it has waited for."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in used)


def _tail(path: Path) -> str:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 20 * _LONGEST_LINE))
        return last_line(file.read().decode(errors="replace"))


def last_line(text: str) -> str:
    """The last line of `text` that says anything, without what cannot be printed; '' when none does."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    line = "".join(c for c in lines[-1] if c.isprintable()) if lines else ""
    return line if len(line) <= _LONGEST_LINE else f"{line[:_LONGEST_LINE]} ..."
