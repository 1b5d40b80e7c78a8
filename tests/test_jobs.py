"""Jobs: each is done once, whatever is killed and wherever it runs, to the same bytes."""

import contextlib
import hashlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from pathlib import Path

import pytest
from refusal import assert_refused

from freeart21 import jobs as module
from freeart21.files import atomic
from freeart21.jobs import ATTEMPTS, Executor, Job, Ledger, Slurm, run_jobs

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}


def write(folder: str, k: int, wait: float) -> None:
    """What a job does: two files, the second a while after the first; every beginning is written down."""
    with Path(folder, "started.txt").open("a") as file:
        file.write(f"{k} ")
    atomic.write_bytes(Path(folder, f"{k}a"), b"text" * k)
    time.sleep(wait)
    atomic.write_bytes(Path(folder, f"{k}b"), b"text" * 1000 * k)


def fail(how: str) -> None:
    if how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    print("first line", file=sys.stderr)
    sys.exit(f"freeart21: {how}")


@pytest.fixture(autouse=True)
def jobs_find_this_file(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tests"))


def writing(folder: Path, n: int, wait: float = 0.1) -> list[Job]:
    return [Job(f"write/{k}", "test_jobs:write", {"folder": str(folder), "k": k, "wait": wait}) for k in range(n)]


def results(folder: Path) -> dict[str, str]:
    """Every file of the results with its hash."""
    files = [path for path in folder.glob("*") if path.is_file() and path.name != "started.txt"]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(files)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, str]:
    """What six jobs make without any interruption."""
    folder = tmp_path_factory.mktemp("whole")
    for k in range(6):
        write(str(folder), k, 0)
    return results(folder)


def started(folder: Path) -> list[str]:
    return (folder / "started.txt").read_text().split() if (folder / "started.txt").exists() else []


def test_jobs_are_done_once_and_skipped_afterwards(tmp_path, whole):
    done = []
    for _ in range(2):
        assert run_jobs(tmp_path, writing(tmp_path, 6), 3, on_done=done.append) == {}
    assert sorted(job.name for job in done) == [f"write/{k}" for k in range(6)]
    assert results(tmp_path) == whole and sorted(started(tmp_path)) == [str(k) for k in range(6)]
    assert run_jobs(tmp_path, writing(tmp_path, 1, 0.0), on_done=done.append) == {} and len(done) == 7  # another job


def test_a_job_that_fails_stops_no_other_and_is_tried_again(tmp_path):
    bad = [Job("bad", "test_jobs:fail", {"how": "no luck"}), Job("none", "test_jobs:nothing")]
    for _ in range(2):
        failed = run_jobs(tmp_path, [*bad, *writing(tmp_path, 1)])
        assert failed["bad"] == "no luck" and "nothing" in failed["none"] and len(failed) == 2
    assert started(tmp_path) == ["0"]


def test_a_job_whose_process_is_killed_starts_again_as_often_as_is_said(tmp_path):
    failed = run_jobs(tmp_path, [Job("killed", "test_jobs:fail", {"how": "killed"})])
    assert failed["killed"].startswith(f"its process was killed {ATTEMPTS} times")


def test_a_job_that_takes_longer_than_its_limit_has_failed(tmp_path):
    (job,) = writing(tmp_path, 1, 600)
    assert "more than 1 s" in run_jobs(tmp_path, [Job(job.name, job.call, job.arguments, limit_s=1)])[job.name]
    assert not job_processes(str(tmp_path))


def test_an_unknown_executor_lists_the_known_and_slurm_says_what_it_lacks(tmp_path, monkeypatch):
    assert_refused("local, ray, slurm", run_jobs, tmp_path, writing(tmp_path, 1), executor="cloud")
    assert_refused("0 workers", run_jobs, tmp_path, writing(tmp_path, 1), 0)
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert_refused("no command sbatch", run_jobs, tmp_path, writing(tmp_path, 1), executor="slurm")


# --- a cluster that is dead -------------------------------------------------------------------------------------------


class Cluster(Executor):
    """Workers that never answer, or that die with their jobs."""

    queue_s = 0.0

    def __init__(self, answer: Future):
        super().__init__(2, Path())
        self.answer, self.closed = answer, False

    def submit(self, job, request):
        self.jobs.append(job.name)
        return self.answer

    def close(self):
        self.closed = True


def test_a_cluster_that_never_answers_ends_the_run_with_one_line(tmp_path, monkeypatch):
    clock = iter(range(0, 10**9, 1000))  # each look at it is 1000 s later
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    dead = Cluster(Future())
    assert_refused("Cluster does not answer: none of 2", run_jobs, tmp_path, writing(tmp_path, 3), executor=dead)
    assert dead.closed and dead.jobs == ["write/0", "write/1"]


def test_jobs_that_are_lost_with_their_workers_have_failed_after_some_attempts(tmp_path):
    answer: Future = Future()
    answer.set_exception(ConnectionError("the node is gone\nin many lines"))
    cluster = Cluster(answer)
    failed = run_jobs(tmp_path, writing(tmp_path, 2), executor=cluster)
    assert set(failed.values()) == {f"its process was killed {ATTEMPTS} times (the node is gone)"}
    assert len(cluster.jobs) == 2 * ATTEMPTS and cluster.closed


# --- killed -----------------------------------------------------------------------------------------------------------

RUN = (
    "import sys; from freeart21 import processes; from test_jobs import *\n"
    "processes.listen(); folder = Path(sys.argv[1])\n"
    "with processes.report_errors(): run_jobs(folder, writing(folder, 6, float(sys.argv[2])), 2)"
)


def start_run(folder: Path, wait: float, **options) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-c", RUN, str(folder), str(wait)], env=ENVIRONMENT, **options)


def until(true, patience_s: float = 120.0) -> None:
    for _ in range(int(patience_s / 0.02)):
        if true():
            return
        time.sleep(0.02)
    raise AssertionError("waited in vain")


def job_processes(folder: str) -> list[int]:
    """Processes of jobs whose log is in `folder`."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if b"freeart21.jobs" in (place / "cmdline").read_bytes() and str((place / "fd/1").readlink()).startswith(
                folder
            ):
                found.append(int(place.name))
    return found


def test_a_run_that_is_killed_again_and_again_goes_on_to_the_same_bytes(tmp_path, whole):
    draw = random.Random(0)
    for kill in range(3):
        with start_run(tmp_path, 0.1) as run:
            until(lambda: len(started(tmp_path)) > kill or run.poll() is not None)  # noqa: B023
            time.sleep(draw.uniform(0, 0.3))
            run.send_signal(signal.SIGKILL)
        until(lambda: not job_processes(str(tmp_path)))  # its jobs end with it
        for name, sha256 in results(tmp_path).items():
            assert name.endswith(".part") or whole[name] == sha256, (kill, name)  # whatever has its name is whole
    assert run_jobs(tmp_path, writing(tmp_path, 6), 2) == {}
    assert {name: sha256 for name, sha256 in results(tmp_path).items() if not name.endswith(".part")} == whole


def test_ctrl_c_ends_with_130_and_its_jobs_with_it(tmp_path):
    def as_from_a_terminal() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell's background jobs ignore it

    with start_run(tmp_path, 600, stderr=-1, text=True, preexec_fn=as_from_a_terminal) as run:
        until(lambda: len(started(tmp_path)) == 2)
        assert_refused("another process runs jobs", run_jobs, tmp_path, writing(tmp_path, 1))
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=120)
    assert run.returncode == 130 and errors.strip() == "freeart21: stopped", errors
    assert not job_processes(str(tmp_path)) and not list(tmp_path.rglob("*lock"))


def test_the_same_job_done_by_two_at_a_time_is_done_once(tmp_path):
    """As when a cluster still runs what a killed run had submitted."""
    both = [threading.Thread(target=Ledger(tmp_path).run, args=writing(tmp_path, 1, 0.3)) for _ in range(2)]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    assert started(tmp_path) == ["0"]


# --- elsewhere --------------------------------------------------------------------------------------------------------


def test_submitits_own_executor_runs_them_to_the_same_bytes(tmp_path, whole, monkeypatch):
    """No SLURM was at hand: submitit's local stand-in shows the wiring, not a cluster."""
    pytest.importorskip("submitit")
    monkeypatch.setenv("PYTHONPATH", ENVIRONMENT["PYTHONPATH"])
    bad = Job("bad", "test_jobs:fail", {"how": "no luck"})
    assert run_jobs(tmp_path, [*writing(tmp_path, 6), bad], executor=Slurm(4, tmp_path, "local")) == {"bad": "no luck"}
    assert results(tmp_path) == whole


def test_rays_workers_killed_at_random_lose_nothing(tmp_path, whole):
    ray = pytest.importorskip("ray")
    draw, over = random.Random(2), threading.Event()

    def kill() -> None:
        for _ in range(2):
            until(lambda: over.is_set() or job_processes(str(tmp_path)))
            for pid in job_processes(str(tmp_path))[:1]:
                time.sleep(draw.uniform(0, 0.3))
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        assert run_jobs(tmp_path, writing(tmp_path, 6, 0.3), 2, "ray") == {}
    finally:
        over.set()
        thread.join()
    assert not ray.is_initialized() and results(tmp_path) == whole
