"""Runs one job in a process of its own, which ends with the process that started it."""

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
from freeart21.ending import os_error_text
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.json_record import read_record
from freeart21.files.lock import hold_lock
from freeart21.jobs.job import Job
from freeart21.jobs.ledger import Ledger

PATIENCE_S = 15.0
"""Clean-up time of a job after a stop signal."""
_FOR_EVER_S = 1e9
_LONGEST_LINE = 500
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "LP_NUM_THREADS")
"""Environment variables that clusters set, and that can change the last bit of a sum."""


@dataclass(frozen=True)
class ProcessExit:
    """How the process of a job ended. The job's results are in its files."""

    name: str
    code: int
    """Exit code. Negative: it was killed by that signal, or lost with its machine."""
    line: str = ""
    """Its last line on standard error."""


def encode_request(folder: Path, job: Job, digest: str) -> str:
    """The input of a job's process, as one line of JSON."""
    threads = {name: os.environ.get(name) for name in _THREADS}
    facts = {"folder": str(Path(folder).resolve()), "job": job.to_json(), "digest": digest, "threads": threads}
    return json.dumps(facts)


def start_process(request: str) -> subprocess.Popen[str]:
    """Start the process for `request`, in a session of its own. It ends when its standard input does."""
    process = subprocess.Popen(
        child.command("freeart21.jobs.worker"),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):
        process.stdin.write(request + "\n")
        process.stdin.flush()
    return process


def wait_for_exit(name: str, process: subprocess.Popen[str]) -> ProcessExit:
    """Wait for `process`; gives how it ended."""
    assert process.stdin is not None and process.stderr is not None
    text = process.stderr.read()
    code = process.wait()
    if code < 0:  # its children may still run
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stderr):
        with contextlib.suppress(OSError):
            pipe.close()
    return ProcessExit(name, code, last_line(text))


def run_in_process(name: str, request: str) -> tuple[str, int, str]:
    """Run `request` in a process and wait for it, on a cluster's worker; gives the fields of `ProcessExit`."""
    end = wait_for_exit(name, start_process(request))
    return end.name, end.code, end.line


# --- in the job's own process -----------------------------------------------------------------------------------------


def main() -> None:
    """Run the job on standard input. When standard input ends, so has the parent, and this process ends."""
    stopping.listen()
    request = json.loads(sys.stdin.readline())

    def end_with_the_parent() -> None:
        while os.read(0, 4096):
            pass
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpid(), signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=end_with_the_parent, daemon=True).start()
    for name, value in request["threads"].items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
    try:
        run_job(Path(request["folder"]), read_record(Job, request["job"], "job"), request["digest"])
        stopping.raise_if_stopped()
    except KeyboardInterrupt:
        sys.exit(128 + (stopping.stop_signal() or signal.SIGINT))
    except FreeArtError as error:
        sys.exit(str(error))
    except Exception as error:
        print(f"{type(error).__name__}: {child.one_line(error)}", file=sys.__stderr__, flush=True)
        sys.exit(70)


def run_job(folder: Path, job: Job, digest: str) -> None:
    """Run `job` unless it is finished. Writes its output atomically, then its statistics, then its marker.

    A second process with the same job waits until the first has finished it. A failed job has statistics but no marker.
    Raises FreeArtError when its output is not its own, or the disk cannot be written.
    """
    ledger = Ledger(folder)
    with hold_lock(ledger.path("running", job.name, ".lock"), f"job '{job.name}' is running elsewhere", _FOR_EVER_S):
        if ledger.finished(job, digest):
            return
        ledger.begin(job)
        out = None if job.out is None else folder / job.out
        if out is not None:
            atomic.recover_folder(out)
            if not job.resumes:
                _clear(out)
        began, before = time.monotonic(), _cpu_s()
        with _temporary_path(out if "{out}" in json.dumps(job.to_json()) else None) as place:
            words = {"{folder}": str(folder), "{python}": sys.executable, "{out}": str(place)}
            code, line, returned = _run(ledger, job, words)
            if code in job.codes and out is not None and place is not None and place.exists():
                stopping.raise_if_stopped()
                out.parent.mkdir(parents=True, exist_ok=True)
                if out.exists() and job.resumes:
                    _clear(out)
                place.replace(out)
        good = code in job.codes
        if good and out is not None and not out.exists():
            good, line = False, line or f"it ended with exit code {code} and did not make {job.out}"
        facts = {"good": good, "code": code, "line": line, "returned": returned, "machine": platform.node()}
        seconds = {"seconds": round(time.monotonic() - began, 3), "cpu_seconds": round(_cpu_s() - before, 3)}
        ledger.write_statistics(job, digest, **facts, **seconds)
        if good:
            os.sync()  # the job's files reach the disk before the marker
            ledger.finish(job, digest)


def _run(ledger: Ledger, job: Job, words: dict[str, str]) -> tuple[int, str, Any]:
    """Run a job with its logs; gives exit code, last line of standard error, and a call's return value."""
    logs = [ledger.path("logs", job.name, ending) for ending in (".out.txt", ".err.txt")]
    logs[0].parent.mkdir(parents=True, exist_ok=True)
    returned: Any = None
    with logs[0].open("wb") as out, logs[1].open("wb") as err:
        if job.command:
            argv = [word for given in job.command for word in _expand_word(given, words)]
            code = _command(argv, ledger.folder, out, err)
        else:
            code, returned = _call(job, words, out, err)
    line = _tail(logs[1])
    if code < 0:
        line = f"killed by signal {-code}" + (", for want of memory perhaps" if code == -signal.SIGKILL else "")
    elif code not in job.codes and not line:
        line = f"exit code {code}, without a message"
    return code, line.removeprefix("freeart21: "), returned


def _expand_word(given: str, words: dict[str, str]) -> list[str]:
    if given == "{freeart21}":
        return child.command("freeart21.__main__")
    return [_fill(given, words)]


def _fill(value: Any, words: dict[str, str]) -> Any:
    if isinstance(value, str):
        for name, word in words.items():
            value = value.replace(name, word)
        return value
    if isinstance(value, dict):
        return {key: _fill(inner, words) for key, inner in value.items()}
    return [_fill(inner, words) for inner in value] if isinstance(value, list | tuple) else value


def _command(argv: list[str], folder: Path, out: Any, err: Any) -> int:
    try:
        process = subprocess.Popen(
            argv, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err, preexec_fn=kill_with_parent()
        )
    except OSError as error:
        err.write(f"cannot run {argv[0]}: {os_error_text(error)}\n".encode())
        return 127
    return wait_for_child(process)


def kill_with_parent() -> Callable[[], None]:
    """A `preexec_fn` for child processes of a job: the kernel kills them when this process is killed. Linux only.

    Normally the process group ends with this process's standard input. But Ray and the out-of-memory killer can kill
    this process alone, and its children would go on unseen.
    """
    if sys.platform != "linux":
        return lambda: None
    prctl, parent = ctypes.CDLL(None).prctl, os.getpid()

    def ask() -> None:
        prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:
            os._exit(1)

    return ask


def wait_for_child(process: subprocess.Popen[bytes]) -> int:
    """Wait for a child process of a job; gives its exit code.

    A stop signal reaches it, too, as it is in the same process group: it then has PATIENCE_S to clean up.
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
    """Call the job's function; gives exit code and return value. All output, also of native code, goes to the logs."""
    saved = [os.dup(1), os.dup(2)]
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os.dup2(out.fileno(), 1)
    os.dup2(err.fileno(), 2)
    try:
        module, function = job.call.split(":")
        return 0, getattr(importlib.import_module(module), function)(**_fill(job.arguments, words))
    except FreeArtError as error:
        print(f"freeart21: {error}", file=sys.stderr)
        return 1, None
    except Exception as error:
        if stopping.stop_signal():
            raise KeyboardInterrupt from error
        import traceback

        traceback.print_exc()
        print(f"{type(error).__name__}: {child.one_line(error)}", file=sys.stderr)
        return 70, None
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for k, handle in enumerate(saved):
            os.dup2(handle, k + 1)
            os.close(handle)


@contextlib.contextmanager
def _temporary_path(out: Path | None) -> Iterator[Path | None]:
    """A path with the name of `out`, in a hidden folder next to it that is removed after the block."""
    if out is None:
        yield None
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        holder = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.", suffix=atomic.PART_SUFFIX))
    except OSError as error:
        raise atomic.cannot_write(out, error) from error
    try:
        yield holder / out.name
    finally:
        with stopping.defer_stop():
            shutil.rmtree(holder, ignore_errors=True)


def _clear(out: Path) -> None:
    """Remove `out` atomically: it is renamed first."""
    if not out.exists() and not out.is_symlink():
        return
    holder = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.", suffix=atomic.PART_SUFFIX))
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
    """The last line of `text` that is not blank, printable characters only; '' without one."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    line = "".join(c for c in lines[-1] if c.isprintable()) if lines else ""
    return line if len(line) <= _LONGEST_LINE else f"{line[:_LONGEST_LINE]} ..."
