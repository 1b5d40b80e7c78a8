"""Where jobs run. An executor starts the process of a job and reports its end.

Results are in the files of the job's folder, which every worker must see: on a cluster, a shared file system.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from freeart21 import child, stopping
from freeart21.errors import FreeArtError
from freeart21.jobs.worker import PATIENCE_S, ProcessExit, run_in_process, start_process, wait_for_exit

MOST_WORKERS = 10_000
"""Most jobs at once: the default limit of schedulers (SLURM's MaxJobCount is 10,000)."""
_POLL_S = 0.02  # poll interval: jobs take seconds
_LOST = -9
"""Exit code of a job that was lost with its worker."""


class Executor(Protocol):
    """Runs the processes of jobs. Leaving its context ends those that still run."""

    workers: int
    """Largest number of jobs at once."""

    def __enter__(self) -> Executor: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None: ...

    def start(self, name: str, request: str, seconds: float) -> None:
        """Start a job from `worker.encode_request`; `seconds` is an estimate of its time."""

    def wait(self) -> list[ProcessExit]:
        """Wait until a job has ended; gives all that have."""


def executor_named(name: str, workers: int, folder: Path) -> Executor:
    """The executor `name` for the jobs of `folder`; FreeArtError when it is unknown or not installed."""
    if name not in EXECUTORS:
        raise FreeArtError(f"unknown executor '{name}'; executors: {', '.join(EXECUTORS)}")
    if not 1 <= workers <= MOST_WORKERS:
        raise FreeArtError(f"cannot run jobs with {workers} workers; expected 1 to {MOST_WORKERS}")
    return EXECUTORS[name](workers, folder)


class Local:
    """Processes of this machine."""

    def __init__(self, workers: int, folder: Path) -> None:
        self.workers = workers
        self._running: dict[str, subprocess.Popen[str]] = {}

    def __enter__(self) -> Local:
        return self

    def __exit__(self, *_: object) -> None:
        """Send a stop signal to running jobs, give them time to clean up, then kill them."""
        with stopping.defer_stop():
            for process in self._running.values():
                _signal(process, signal.SIGTERM)
            deadline = time.monotonic() + PATIENCE_S
            for process in self._running.values():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(max(0.0, deadline - time.monotonic()))
            for name, process in self._running.items():
                _signal(process, signal.SIGKILL)  # with the rest of its process group
                wait_for_exit(name, process)
            self._running.clear()

    def start(self, name: str, request: str, seconds: float) -> None:
        """As `Executor.start`."""
        with stopping.defer_stop():
            self._running[name] = start_process(request)

    def wait(self) -> list[ProcessExit]:
        """As `Executor.wait`."""
        while True:
            over = [name for name, process in self._running.items() if process.poll() is not None]
            if over or not self._running:
                return [wait_for_exit(name, self._running.pop(name)) for name in over]
            time.sleep(_POLL_S)


def _signal(process: subprocess.Popen[str], number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


class Ray:
    """Tasks of Ray, on the cluster of RAY_ADDRESS or, without it, on this machine."""

    def __init__(self, workers: int, folder: Path) -> None:
        self.workers = workers
        self._ray = _import("ray")
        self._names: dict[Any, str] = {}
        self._task: Any = None

    def __enter__(self) -> Ray:
        handlers = {number: signal.getsignal(number) for number in stopping.SIGNALS}
        own = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": self.workers, "include_dashboard": False}
        found = os.pathsep.join(place for place in sys.path if place)
        try:
            self._ray.init(
                log_to_driver=False,
                logging_level="ERROR",
                runtime_env={"env_vars": {"PYTHONPATH": found}},
                **own,
            )
        except Exception as error:
            raise FreeArtError(f"Ray does not start: {str(error).splitlines()[0]}") from error
        finally:
            for number, handler in handlers.items():  # Ray replaces some
                signal.signal(number, handler)
        # `run_jobs` counts and restarts lost jobs
        self._task = self._ray.remote(num_cpus=1, max_retries=0)(run_in_process)
        return self

    def __exit__(self, *_: object) -> None:
        with stopping.defer_stop():
            for reference in self._names:
                with contextlib.suppress(Exception):
                    self._ray.cancel(reference, force=True)
            self._names.clear()
            self._ray.shutdown()

    def start(self, name: str, request: str, seconds: float) -> None:
        """As `Executor.start`."""
        self._names[self._task.remote(name, request)] = name

    def wait(self) -> list[ProcessExit]:
        """As `Executor.wait`."""
        over: list[Any] = []
        while not over and self._names:
            stopping.raise_if_stopped()
            over, _ = self._ray.wait(list(self._names), num_returns=1, timeout=0.5)
        return [self._exit_of(reference) for reference in over]

    def _exit_of(self, reference: Any) -> ProcessExit:
        name = self._names.pop(reference)
        try:
            return ProcessExit(*self._ray.get(reference))
        except self._ray.exceptions.RayError as error:
            return ProcessExit(name, _LOST, str(error).splitlines()[0])


class Slurm:
    """Jobs of SLURM, by submitit. sbatch's variables (SBATCH_PARTITION, SBATCH_ACCOUNT, ...) choose the partition."""

    CORES, MEMORY_GB = 2, 8
    LONGEST_RATIO, LEAST_MINUTES = 10.0, 60
    """Time limit of a job: LONGEST_RATIO times its estimate, at least LEAST_MINUTES."""

    def __init__(self, workers: int, folder: Path, cluster: str = "slurm") -> None:
        """`cluster` 'local' and 'debug' are submitit's substitutes for tests."""
        self.workers = workers
        submitit = _import("submitit")
        if cluster == "slurm" and shutil.which("sbatch") is None:
            raise FreeArtError("there is no SLURM here: no command sbatch; run this where jobs are submitted")
        self._executor = submitit.AutoExecutor(folder=Path(folder) / ".jobs" / "submitit", cluster=cluster)
        self._running: dict[str, Any] = {}

    def __enter__(self) -> Slurm:
        return self

    def __exit__(self, *_: object) -> None:
        with stopping.defer_stop():
            for job in self._running.values():
                with contextlib.suppress(Exception):
                    job.cancel(check=False)
            self._running.clear()

    def start(self, name: str, request: str, seconds: float) -> None:
        """As `Executor.start`."""
        minutes = max(self.LEAST_MINUTES, round(self.LONGEST_RATIO * seconds / 60))
        limits = {"timeout_min": minutes, "cpus_per_task": self.CORES, "mem_gb": self.MEMORY_GB}
        self._executor.update_parameters(name="freeart21", **limits)
        self._running[name] = self._executor.submit(run_in_process, name, request)

    def wait(self) -> list[ProcessExit]:
        """As `Executor.wait`."""
        while True:
            over = [name for name, job in self._running.items() if job.done()]
            if over or not self._running:
                return [self._exit_of(name) for name in over]
            time.sleep(0.2)

    def _exit_of(self, name: str) -> ProcessExit:
        try:
            return ProcessExit(*self._running.pop(name).result())
        except Exception as error:  # of many types: cancelled, out of time, node lost
            return ProcessExit(name, _LOST, child.one_line(error))


def _import(module: str) -> Any:
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise FreeArtError(f"{module} is not installed; `pip install 'freeart21[cluster]'` installs it") from error


EXECUTORS: dict[str, Callable[[int, Path], Executor]] = {"local": Local, "ray": Ray, "slurm": Slurm}
"""Name to a function of the number of jobs at once and the folder of jobs."""
