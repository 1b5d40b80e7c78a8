"""Where jobs run. An executor starts a job somewhere and says when its process has ended; it knows no more.

What came of a job stands in the files of its folder, which every worker must see: on a cluster, a shared file system.
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

from freeart21 import stopping
from freeart21.errors import FreeArtError
from freeart21.jobs.work import PATIENCE_S, Ended, ended, in_a_process, start

MOST_WORKERS = 10_000
"""Jobs at once: the longest list that schedulers take as they are shipped (SLURM's MaxJobCount is 10,000)."""
_POLL_S = 0.02  # between looks at processes: jobs take seconds
_LOST = -9
"""Code of a job that was lost with the worker that ran it."""


class Executor(Protocol):
    """Runs the processes of jobs; leaving its context ends those that still run."""

    workers: int
    """Jobs that it is given at once."""

    def __enter__(self) -> Executor: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None: ...

    def start(self, name: str, asked: str, seconds: float) -> None:
        """Begin a job: what `work.request` says, and about how long it takes."""

    def wait(self) -> list[Ended]:
        """Those that have ended since; waits until there is one."""


def executor_named(name: str, workers: int, folder: Path) -> Executor:
    """The executor `name` for the jobs of `folder`; FreeArtError lists the known ones, or says what it needs."""
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
        """Tell those that run to stop, give them time to clear up, and end them."""
        with stopping.deferred():
            for process in self._running.values():
                _signal(process, signal.SIGTERM)
            deadline = time.monotonic() + PATIENCE_S
            for process in self._running.values():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(max(0.0, deadline - time.monotonic()))
            for name, process in self._running.items():
                _signal(process, signal.SIGKILL)  # also what it may have left of its group
                ended(name, process)
            self._running.clear()

    def start(self, name: str, asked: str, seconds: float) -> None:
        """As `Executor.start`."""
        with stopping.deferred():
            self._running[name] = start(asked)

    def wait(self) -> list[Ended]:
        """As `Executor.wait`."""
        while True:
            over = [name for name, process in self._running.items() if process.poll() is not None]
            if over or not self._running:
                return [ended(name, self._running.pop(name)) for name in over]
            time.sleep(_POLL_S)


def _signal(process: subprocess.Popen[str], number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, number)


class Ray:
    """Tasks of Ray: of the cluster that RAY_ADDRESS names or, without it, of a Ray that is started on this machine."""

    def __init__(self, workers: int, folder: Path) -> None:
        self.workers = workers
        self._ray = _imported("ray", "ray")
        self._names: dict[Any, str] = {}
        self._task: Any = None

    def __enter__(self) -> Ray:
        heard = {number: signal.getsignal(number) for number in stopping.SIGNALS}
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
            for number, handler in heard.items():  # Ray takes some of them
                signal.signal(number, handler)
        # a job that was lost is counted and begun again by who runs the jobs, as everywhere
        self._task = self._ray.remote(num_cpus=1, max_retries=0)(in_a_process)
        return self

    def __exit__(self, *_: object) -> None:
        with stopping.deferred():
            for reference in self._names:
                with contextlib.suppress(Exception):
                    self._ray.cancel(reference, force=True)
            self._names.clear()
            self._ray.shutdown()

    def start(self, name: str, asked: str, seconds: float) -> None:
        """As `Executor.start`."""
        self._names[self._task.remote(name, asked)] = name

    def wait(self) -> list[Ended]:
        """As `Executor.wait`."""
        over: list[Any] = []
        while not over and self._names:
            stopping.check()
            over, _ = self._ray.wait(list(self._names), num_returns=1, timeout=0.5)
        return [self._ended(reference) for reference in over]

    def _ended(self, reference: Any) -> Ended:
        name = self._names.pop(reference)
        try:
            return Ended(*self._ray.get(reference))
        except self._ray.exceptions.RayError as error:
            return Ended(name, _LOST, str(error).splitlines()[0])


class Slurm:
    """Jobs of SLURM, through submitit. sbatch's own variables (SBATCH_PARTITION, SBATCH_ACCOUNT, ...) choose where."""

    CORES, MEMORY_GB = 2, 8
    LONGEST_RATIO, LEAST_MINUTES = 10.0, 60
    """The time limit of a job: so many times its estimate, and no less than so many minutes."""

    def __init__(self, workers: int, folder: Path, cluster: str = "slurm") -> None:
        """`cluster` 'local' or 'debug' are submitit's own stand-ins, for tests."""
        self.workers = workers
        submitit = _imported("submitit", "submitit")
        if cluster == "slurm" and shutil.which("sbatch") is None:
            raise FreeArtError("there is no SLURM here: no command sbatch; run this where jobs are submitted")
        self._executor = submitit.AutoExecutor(folder=Path(folder) / ".jobs" / "submitit", cluster=cluster)
        self._running: dict[str, Any] = {}

    def __enter__(self) -> Slurm:
        return self

    def __exit__(self, *_: object) -> None:
        with stopping.deferred():
            for job in self._running.values():
                with contextlib.suppress(Exception):
                    job.cancel(check=False)
            self._running.clear()

    def start(self, name: str, asked: str, seconds: float) -> None:
        """As `Executor.start`."""
        minutes = max(self.LEAST_MINUTES, round(self.LONGEST_RATIO * seconds / 60))
        limits = {"timeout_min": minutes, "cpus_per_task": self.CORES, "mem_gb": self.MEMORY_GB}
        self._executor.update_parameters(name="freeart21", **limits)
        self._running[name] = self._executor.submit(in_a_process, name, asked)

    def wait(self) -> list[Ended]:
        """As `Executor.wait`."""
        while True:
            over = [name for name, job in self._running.items() if job.done()]
            if over or not self._running:
                return [self._ended(name) for name in over]
            time.sleep(0.2)

    def _ended(self, name: str) -> Ended:
        try:
            return Ended(*self._running.pop(name).result())
        except Exception as error:  # submitit's, of many kinds: it was cancelled, ran out of time, lost its node
            return Ended(
                name, _LOST, str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            )


def _imported(module: str, what: str) -> Any:
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise FreeArtError(f"{what} is not installed; `pip install 'freeart21[cluster]'` installs it") from error


EXECUTORS: dict[str, Callable[[int, Path], Executor]] = {"local": Local, "ray": Ray, "slurm": Slurm}
"""By name: made of the number of jobs at once and the folder of jobs."""
