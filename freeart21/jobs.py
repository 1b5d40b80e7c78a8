"""Jobs: calls of functions of this project, each done once, here or on a cluster, whatever is killed meanwhile.

The ledger of a folder of jobs is `.jobs/` in it: a log of each job and, written last, a marker when it is finished.
Jobs with a marker are skipped, so that a killed run resumes. Results are in files that every worker must see.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.lock import hold_lock
from freeart21.processes import report_errors

ATTEMPTS = 3
"""Times that a job is started when its process is killed. A job that fails by itself is not started again."""
PATIENCE_S = 15.0
"""Clean-up time of a job after a stop signal."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "LP_NUM_THREADS")
"""Environment variables that clusters set, and that can change the last bit of a sum."""


@dataclass(frozen=True)
class Job:
    """A call that can be repeated: its function writes its results atomically, and goes on with what it finds."""

    name: str
    """Unique: words joined by '/'."""
    call: str
    """'module:function'."""
    arguments: dict[str, Any] = field(default_factory=dict)
    """Keyword arguments, plain JSON."""
    processors: int = 1
    memory_gb: float = 4.0
    gpus: int = 0
    """What a scheduler reserves for it."""
    limit_s: float = 3600.0
    """Longest time, s. A job that takes longer has failed."""

    @property
    def digest(self) -> str:
        """Of all that decides its results: with another one it is another job."""
        return hashlib.sha256(json.dumps([self.call, self.arguments], sort_keys=True).encode()).hexdigest()


class Ledger:
    """The files of a folder of jobs. Readers and writers can be killed at any moment."""

    def __init__(self, folder: Path) -> None:
        self.place = Path(folder) / ".jobs"

    def path(self, what: str, name: str, ending: str = ".json") -> Path:
        """The file of the job `name` in the folder `what` of `.jobs`: done, logs, running."""
        return self.place / what / f"{name}{ending}"

    def finished(self, job: Job) -> bool:
        """Whether the job has a marker of its digest."""
        try:
            return checked.read_json(self.path("done", job.name)).get("digest") == job.digest
        except FreeArtError:
            return False

    def run(self, job: Job) -> None:
        """Call the job's function unless it is finished, then write its marker. A second process waits for this one."""
        lock = self.path("running", job.name, ".lock")
        with hold_lock(lock, f"job '{job.name}' is running elsewhere", patience_s=1e9):
            if self.finished(job):
                return
            module, function = job.call.split(":")
            getattr(importlib.import_module(module), function)(**job.arguments)
            processes.raise_if_stopped()
            os.sync()  # the job's files reach the disk before the marker
            atomic.write_json(self.path("done", job.name), {"digest": job.digest})


# --- where jobs run ---------------------------------------------------------------------------------------------------


class Executor:
    """Starts jobs, and ends them."""

    queue_s = math.inf
    """Longest time from the submission of a job to its begin, s."""

    def __init__(self, workers: int, folder: Path) -> None:
        """`workers` jobs at a time, of the folder of jobs `folder`."""
        self.workers = workers
        self.jobs: list[Any] = []

    def submit(self, job: Job, request: dict[str, Any]) -> Any:
        """Start a job. Gives what has `done()` and `result()` (that of `run_in_process`; it raises when the job was
        lost), as futures of `concurrent.futures` and jobs of submitit have."""
        raise NotImplementedError

    def close(self) -> None:
        """End the jobs that still run."""
        raise NotImplementedError


class Local(Executor):
    """Processes of this machine. Each is ended here when its limit has passed: none is waited for in vain."""

    def __init__(self, workers: int, folder: Path) -> None:
        super().__init__(workers, folder)
        self._pool = ThreadPoolExecutor(workers)  # a thread waits for a process

    def submit(self, job: Job, request: dict[str, Any]) -> Any:
        """As `Executor.submit`."""
        with processes.defer_stop():
            self.jobs.append(_start_process(request))
            return self._pool.submit(_wait_for_exit, self.jobs[-1], request)

    def close(self) -> None:
        """Send a stop signal to running jobs, give them time to clean up, then kill them."""
        alive = [process for process in self.jobs if process.poll() is None]
        for process in alive:
            _signal(process, signal.SIGTERM)
        for process in alive:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE_S)
            _signal(process, signal.SIGKILL)  # with the rest of its process group
        self._pool.shutdown()


class Ray(Executor):
    """Tasks of Ray, on the cluster of RAY_ADDRESS or, without it, on this machine: there one processor a job."""

    queue_s = 1800.0

    def __init__(self, workers: int, folder: Path) -> None:
        super().__init__(workers, folder)
        self._ray = importlib.import_module("ray")
        handlers = {number: signal.getsignal(number) for number in processes.SIGNALS}
        own = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": self.workers, "include_dashboard": False}
        environment = {"env_vars": {"PYTHONPATH": os.pathsep.join(place for place in sys.path if place)}}
        try:
            self._ray.init(log_to_driver=False, logging_level="ERROR", runtime_env=environment, **own)
        except Exception as error:
            raise FreeArtError(f"Ray does not start: {processes.one_line(error)}") from error
        finally:
            for number, handler in handlers.items():  # Ray replaces some
                signal.signal(number, handler)

    def submit(self, job: Job, request: dict[str, Any]) -> Any:
        """As `Executor.submit`."""
        needs = {"num_cpus": job.processors, "num_gpus": job.gpus, "memory": round(job.memory_gb * 2**30)}
        needs = needs if os.environ.get("RAY_ADDRESS") else {"num_cpus": 1}
        task = self._ray.remote(**needs, max_retries=0)(run_in_process)  # `run_jobs` restarts lost jobs
        self.jobs.append(task.remote(request))
        return self.jobs[-1].future()

    def close(self) -> None:
        """Cancel what runs, and leave the cluster."""
        for reference in self.jobs:
            with contextlib.suppress(Exception):
                self._ray.cancel(reference, force=True)
        self._ray.shutdown()


class Slurm(Executor):
    """Jobs of SLURM, by submitit. sbatch's variables (SBATCH_PARTITION, SBATCH_ACCOUNT, ...) choose the partition."""

    queue_s = 86400.0

    def __init__(self, workers: int, folder: Path, cluster: str = "slurm") -> None:
        """`cluster` 'local' and 'debug' are submitit's substitutes for tests."""
        super().__init__(workers, folder)
        submitit = importlib.import_module("submitit")
        if cluster == "slurm" and shutil.which("sbatch") is None:
            raise FreeArtError("there is no SLURM here: no command sbatch; run this where jobs are submitted")
        self._executor = submitit.AutoExecutor(folder=Path(folder) / ".jobs" / "submitit", cluster=cluster)

    def submit(self, job: Job, request: dict[str, Any]) -> Any:
        """As `Executor.submit`."""
        needs = {"cpus_per_task": job.processors, "mem_gb": job.memory_gb, "gpus_per_node": job.gpus}
        self._executor.update_parameters(name="freeart21", timeout_min=round(job.limit_s / 60) + 1, **needs)
        self.jobs.append(self._executor.submit(run_in_process, request))
        return self.jobs[-1]

    def close(self) -> None:
        """Cancel what runs."""
        for job in self.jobs:
            with contextlib.suppress(Exception):
                if not job.done():
                    job.cancel(check=False)


EXECUTORS: dict[str, Callable[[int, Path], Executor]] = {"local": Local, "ray": Ray, "slurm": Slurm}


# --- a run ------------------------------------------------------------------------------------------------------------


def run_jobs(
    folder: Path,
    jobs: Sequence[Job],
    workers: int = 1,
    executor: str | Executor = "local",
    on_done: Callable[[Job], None] = lambda job: None,
) -> dict[str, str]:
    """Run the unfinished ones of `jobs` in `folder`, up to `workers` at a time; gives the failed ones with the reason.

    `executor` is a name in EXECUTORS, or an executor (with its own number of workers). A failed job does not stop the
    others. `on_done` is called with each job that is finished now. The run can be interrupted or killed at any moment:
    the same call resumes it.

    Raises FreeArtError when the executor is unknown, not installed or does not answer any more, or another process runs
    jobs here; KeyboardInterrupt after a stop signal, once the jobs' processes have ended.
    """
    if isinstance(executor, str) and (executor not in EXECUTORS or workers < 1):
        expected = f"executors: {', '.join(EXECUTORS)}, with 1 worker or more"
        raise FreeArtError(f"cannot run jobs by executor '{executor}' with {workers} workers; {expected}")
    ledger, tries, failed = Ledger(folder), Counter[str](), dict[str, str]()
    running: dict[str, tuple[Job, Any]] = {}
    with hold_lock(ledger.place / "lock", f"another process runs jobs in {folder}", patience_s=3.0):
        atomic.remove_leftovers(ledger.place)
        ready = deque(job for job in jobs if not ledger.finished(job))
        if not ready:
            return failed
        try:
            runner = EXECUTORS[executor](workers, folder) if isinstance(executor, str) else executor
        except ImportError as error:
            raise FreeArtError(f"{error}; `pip install 'freeart21[cluster]'` installs it") from error
        heard_at = time.monotonic()
        try:
            while ready or running:
                processes.raise_if_stopped()
                while ready and len(running) < runner.workers:
                    job = ready.popleft()
                    running[job.name] = job, runner.submit(job, _request(folder, job))
                    heard_at = time.monotonic()
                ended = [name for name, (_, started) in running.items() if started.done()]
                if not ended:
                    if time.monotonic() - heard_at > runner.queue_s + max(job.limit_s for job, _ in running.values()):
                        raise FreeArtError(
                            f"{type(runner).__name__} does not answer: none of {len(running)} submitted jobs ended "
                            "within its limit; the same command goes on with what is unfinished"
                        )
                    time.sleep(0.05)
                for name in ended:
                    job, started = running.pop(name)
                    heard_at, tries[name] = time.monotonic(), tries[name] + 1
                    try:
                        code, line = started.result()
                    except Exception as error:  # of many types: cancelled, out of time, node lost
                        code, line = -signal.SIGKILL, processes.one_line(error)
                    if ledger.finished(job):
                        on_done(job)
                    elif code < 0 and tries[name] < ATTEMPTS:
                        ready.append(job)
                    else:
                        reason = line or f"exit code {code}"
                        failed[name] = reason if code >= 0 else f"its process was killed {ATTEMPTS} times ({reason})"
        finally:
            with processes.defer_stop():
                runner.close()
    return failed


# --- the process of a job ---------------------------------------------------------------------------------------------


def run_in_process(request: dict[str, Any]) -> tuple[int, str]:
    """Run a job (`_request`) in a process and wait for it, on a cluster's worker; gives exit code and last line."""
    return _wait_for_exit(_start_process(request), request)


def _request(folder: Path, job: Job) -> dict[str, Any]:
    """All that a job's process has to know, as JSON."""
    threads = {name: os.environ.get(name) for name in _THREADS}
    log = Ledger(folder.resolve()).path("logs", job.name, ".txt")
    return {"folder": str(folder.resolve()), "job": asdict(job), "threads": threads, "log": str(log)}


def _start_process(request: dict[str, Any]) -> subprocess.Popen[bytes]:
    """Start the process for `request`, in a session of its own. It ends when its standard input does."""
    log, environment = Path(request["log"]), {**os.environ, **request["threads"]}
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as out:
        process = subprocess.Popen(
            processes.command("freeart21.jobs"),
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=out,
            env={name: value for name, value in environment.items() if value is not None},
            start_new_session=True,
        )
    with contextlib.suppress(BrokenPipeError):
        os.write(process.stdin.fileno(), json.dumps(request).encode() + b"\n")  # type: ignore[union-attr]
    return process


def _wait_for_exit(process: subprocess.Popen[bytes], request: dict[str, Any]) -> tuple[int, str]:
    """Wait for the process of `request`; gives exit code and last line."""
    try:
        code, line = process.wait(request["job"]["limit_s"]), _last_line(Path(request["log"]))
    except subprocess.TimeoutExpired:
        code, line = 124, f"it took more than {request['job']['limit_s']:g} s, its limit"
    _signal(process, signal.SIGKILL)  # with its children, which may still run
    process.wait()
    with contextlib.suppress(OSError):
        process.communicate()
    return code, line


def _signal(process: subprocess.Popen[bytes], number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


def _last_line(log: Path) -> str:
    """The last line of a job's log that is not blank; '' without one."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return "".join(c for c in lines[-1][:500] if c.isprintable()).removeprefix("freeart21: ") if lines else ""


def main() -> None:
    """Run the job on standard input. When standard input ends, so has the parent, and this process ends."""
    processes.listen()
    request = json.loads(sys.stdin.readline())

    def end_with_the_parent() -> None:
        while os.read(0, 4096):
            pass
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpid(), signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=end_with_the_parent, daemon=True).start()
    with report_errors():
        Ledger(Path(request["folder"])).run(Job(**request["job"]))
