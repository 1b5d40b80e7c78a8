"""Jobs: each is done once, whatever is killed and wherever it runs, to the same bytes."""

import contextlib
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from refusal import assert_refused

from freeart21.jobs import Job, read_jobs, run_jobs
from freeart21.jobs.executors import Slurm
from freeart21.jobs.ledger import Ledger
from freeart21.jobs.progress import Forecast
from freeart21.jobs.run import unfinished_jobs
from freeart21.jobs.worker import encode_request, run_job, start_process

ROOT = Path(__file__).resolve().parents[1]
WRITE = (  # a folder of two files, the second a while after the first; every beginning is written down
    "import os, sys, time; from pathlib import Path; out, text, wait, log = sys.argv[1:]\n"
    "with open(log, 'a') as file: file.write(text + ' ')\n"
    "os.mkdir(out); Path(out, 'a').write_text(text); time.sleep(float(wait)); Path(out, 'b').write_text(text * 1000)\n"
)


def writing(k: int, wait: float = 0.1, needs: tuple[str, ...] = ()) -> Job:
    command = ("{python}", "-c", WRITE, "{out}", f"text {k}", str(wait), "{folder}/started_jobs.txt")
    return Job(f"write/{k}", command, out=f"results/{k}", needs=needs, seconds=wait)


def chain(n: int, wait: float = 0.1) -> list[Job]:
    """Every third job needs the one three before."""
    return [writing(k, wait, (f"write/{k - 3}",) if k % 3 == 2 and k > 3 else ()) for k in range(n)]


def results(folder: Path) -> dict[str, str]:
    """Every file of the results and every marker, hidden ones too, with its hash."""
    places = [folder / "results", folder / ".jobs" / "done"]
    files = [path for place in places for path in place.rglob("*") if path.is_file()]
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(files)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, str]:
    """What eight jobs make without any interruption."""
    folder = tmp_path_factory.mktemp("whole")
    report = run_jobs(folder, chain(8), 2)
    assert len(report.finished) == 8 and not report.failed
    return results(folder)


def test_jobs_are_done_once_and_skipped_afterwards(tmp_path, whole):
    jobs = chain(8)
    report = run_jobs(tmp_path, jobs, 3)
    assert sorted(report.finished) == sorted(job.name for job in jobs)
    for job in jobs:
        assert all(report.finished.index(need) < report.finished.index(job.name) for need in job.needs)
    assert results(tmp_path) == whole and len(whole) == 24
    assert run_jobs(tmp_path, jobs).skipped == tuple(job.name for job in jobs)
    assert len((tmp_path / "started_jobs.txt").read_text().split()) == 16  # 'text k', once each
    assert read_jobs(tmp_path / "jobs.json") == jobs


def test_a_job_that_fails_stops_those_that_need_it_only_and_is_tried_again(tmp_path):
    code = "import sys; print('first line', file=sys.stderr); print('freeart21: no luck', file=sys.stderr); sys.exit(4)"
    bad = Job("bad", ("{python}", "-c", code), seconds=1)
    jobs = [bad, writing(1, 0, ("bad",)), writing(2, 0, ("write/1",)), writing(3, 0)]
    report = run_jobs(tmp_path, jobs)
    assert report.finished == ("write/3",)
    assert [(f.name, f.reason) for f in report.failed] == [
        ("bad", "no luck"),
        ("write/1", "needs bad, which failed"),
        ("write/2", "needs write/1, which failed"),
    ]
    facts = json.loads((tmp_path / ".jobs/statistics/bad.json").read_text())
    assert facts["code"] == 4 and facts["line"] == "no luck" and not (tmp_path / ".jobs/done/bad.json").exists()
    fixed = [Job("bad", ("{python}", "-c", "pass")), *jobs[1:]]
    report = run_jobs(tmp_path, fixed)
    assert report.finished == ("bad", "write/1", "write/2") and report.skipped == ("write/3",)


def test_a_job_that_makes_nothing_has_failed_whatever_its_exit_code(tmp_path):
    report = run_jobs(tmp_path, [Job("none", ("{python}", "-c", "pass"), out="x")])
    assert "did not make x" in report.failed[0].reason
    half = "import os, sys; os.mkdir(sys.argv[1]); sys.exit(3)"
    report = run_jobs(tmp_path, [Job("half", ("{python}", "-c", half, "{out}"), out="y")])
    assert report.failed and not (tmp_path / "y").exists() and not list(tmp_path.glob(".y*"))
    report = run_jobs(tmp_path, [Job("half", ("{python}", "-c", half, "{out}"), out="y", codes=(0, 3))])
    assert not report.failed and (tmp_path / "y").is_dir()


def test_a_changed_job_and_what_hangs_on_it_are_done_anew(tmp_path):
    jobs = [writing(0, 0), writing(1, 0, ("write/0",)), writing(2, 0)]
    run_jobs(tmp_path, jobs)
    other = Job(**{**vars(jobs[0]), "key": "another input"})
    assert [job.name for job in unfinished_jobs(tmp_path, [other, *jobs[1:]])] == ["write/0", "write/1"]
    assert run_jobs(tmp_path, [other, *jobs[1:]]).finished == ("write/0", "write/1")
    (tmp_path / "results/2/a").unlink()
    (tmp_path / "results/2/b").unlink()
    (tmp_path / "results/2").rmdir()
    assert run_jobs(tmp_path, [other, *jobs[1:]]).finished == ("write/2",)


def test_what_needs_a_changed_job_is_done_anew_also_by_a_later_call(tmp_path):
    jobs = [writing(0, 0), writing(1, 0, ("write/0",))]
    run_jobs(tmp_path, jobs)
    other = Job(**{**vars(jobs[0]), "key": "another input"})
    assert run_jobs(tmp_path, [other]).finished == ("write/0",)
    assert run_jobs(tmp_path, [other, jobs[1]]).finished == ("write/1",)


def test_what_a_job_did_not_make_is_never_replaced(tmp_path):
    (tmp_path / "results" / "0").mkdir(parents=True)
    (tmp_path / "results" / "0" / "mine.txt").write_text("mine")
    report = run_jobs(tmp_path, [writing(0, 0)])
    assert "was not made by the job" in report.failed[0].reason
    assert [path.name for path in (tmp_path / "results" / "0").iterdir()] == ["mine.txt"]


def test_a_call_returns_what_is_kept_and_what_it_raises_is_its_last_line(tmp_path):
    good = Job("good", call="os.path:join", arguments={"a": "{folder}"})
    jobs = [
        Job("length", call="builtins:sorted", arguments={}),
        Job("digest", call="tests_calls_nothing:f"),
        Job("encode", call="freeart21.jobs.job:read_jobs", arguments={"path": "{folder}/none.json"}),
    ]
    report = run_jobs(tmp_path, [good, *jobs])
    reasons = {failed.name: failed.reason for failed in report.failed}
    assert "TypeError" in reasons["length"] and "ModuleNotFoundError" in reasons["digest"]
    assert reasons["encode"].endswith("none.json is missing")
    assert json.loads((tmp_path / ".jobs/statistics/good.json").read_text())["returned"] == str(tmp_path)


@pytest.mark.parametrize(
    "jobs, message",
    [
        ([Job("a", ("x",)), Job("a", ("x",))], "two jobs are called 'a'"),
        ([Job("a", ("x",), needs=("b",))], "needs 'b', which is no job"),
        ([Job("a", ("x",), needs=("b",)), Job("b", ("x",), needs=("a",))], "needs itself"),
        ([Job("a")], "neither a command nor a call"),
        ([Job("a", ("x",), call="os:getcwd")], "both a command and a call"),
        ([Job("../a", ("x",))], "no name of a job"),
        ([Job("a", ("x",), out="../b")], "inside the folder of jobs"),
        ([Job("a", ("x",), out="/b")], "inside the folder of jobs"),
        ([Job("a", ("x",), out="o"), Job("b", ("x",), out="o")], "make the same output"),
    ],
)
def test_a_list_that_is_no_list_of_jobs_is_refused_before_anything_runs(tmp_path, jobs, message):
    assert_refused(message.replace("'", "."), run_jobs, tmp_path / "jobs", jobs)
    assert not (tmp_path / "jobs").exists()


@pytest.mark.parametrize("entry", [{"name": "a", "command": "x"}, {"name": "a", "shell": "x"}, {"name": 3}, "a"])
def test_a_file_of_jobs_is_checked(tmp_path, entry):
    path = tmp_path / "jobs.json"
    path.write_text(json.dumps({"schema": "freeart21/jobs/1", "jobs": [entry]}))
    assert_refused("job 0", read_jobs, path)


def test_an_unknown_executor_lists_the_known_and_slurm_says_what_it_lacks(tmp_path, monkeypatch):
    assert_refused("local, ray, slurm", run_jobs, tmp_path, [writing(0)], executor="cloud")
    assert_refused("0 workers", run_jobs, tmp_path, [writing(0)], 0)
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert_refused("no command sbatch", run_jobs, tmp_path, [writing(0)], executor="slurm")


def test_two_runs_at_a_time_are_refused(tmp_path):
    with subprocess.Popen([sys.executable, "-c", RUN, str(tmp_path), "1", "local", "5"], env=ENVIRONMENT) as other:
        until(lambda: (tmp_path / ".jobs" / "begun" / "write" / "0.json").exists())
        assert_refused("another process runs jobs", run_jobs, tmp_path, chain(2))
        other.kill()


# --- killed -----------------------------------------------------------------------------------------------------------

RUN = (
    "import sys; from freeart21 import stopping; from test_jobs import report_of\n"
    "stopping.listen()\n"
    "sys.exit(report_of(sys.argv[1], int(sys.argv[2]), sys.argv[3], float(sys.argv[4])))"
)
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])}


def report_of(folder: str, jobs: int, executor: str, wait: float) -> int:
    return len(run_jobs(Path(folder), chain(jobs, wait), 2, executor).failed)


def until(true, patience_s: float = 60.0) -> None:
    deadline = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def processes(mark: str) -> list[int]:
    """Processes of jobs in whose command line or environment `mark` stands."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if mark.encode() in (place / "cmdline").read_bytes():
                found.append(int(place.name))
    return found


def started_jobs(folder: Path) -> int:
    place = folder / ".jobs" / "begun"
    return len(list(place.rglob("*.json"))) if place.exists() else 0


def test_a_run_that_is_killed_again_and_again_goes_on_to_the_same_bytes(tmp_path, whole):
    draw = random.Random(0)
    for kill in range(6):
        with subprocess.Popen([sys.executable, "-c", RUN, str(tmp_path), "8", "local", "0.1"], env=ENVIRONMENT) as run:
            until(lambda: (tmp_path / ".jobs" / "lock").exists() or run.poll() is not None)
            time.sleep(draw.uniform(0, 0.9))
            run.send_signal(signal.SIGKILL)
        until(lambda: not processes(str(tmp_path)))  # its jobs end with it
        for path, sha256 in results(tmp_path).items():
            aside = any(part.startswith(".") and part.endswith(".part") for part in Path(path).parts)
            assert aside or whole[path] == sha256, (kill, path)  # whatever has its name is whole
    report = run_jobs(tmp_path, chain(8), 2)
    assert not report.failed and len(report.finished) + len(report.skipped) == 8
    assert results(tmp_path) == whole


def test_jobs_whose_processes_are_killed_start_again(tmp_path, whole):
    """Each as often as `attempts` says, and no more."""
    draw, killed = random.Random(1), set[int]()
    over = threading.Event()

    def kill() -> None:
        while not over.is_set() and len(killed) < 5:
            alive = [pid for pid in processes(str(tmp_path / "results")) if pid not in killed]
            if alive and started_jobs(tmp_path) > 1:
                pid = draw.choice(alive)
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(os.getpgid(pid), signal.SIGKILL)
                killed.add(pid)
            time.sleep(draw.uniform(0.05, 0.3))

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        report = run_jobs(tmp_path, chain(8), 2, attempts=20)
    finally:
        over.set()
        thread.join()
    assert killed and not report.failed and len(report.finished) == 8
    assert results(tmp_path) == whole
    kills_itself = Job("kill", ("{python}", "-c", "import os; os.kill(os.getppid(), 9)"))
    report = run_jobs(tmp_path, [kills_itself], attempts=2)
    assert report.failed[0].reason.startswith("its process was killed 2 times")


def test_ctrl_c_ends_with_130_and_its_jobs_with_it(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", STOPPED, str(tmp_path)],
        env=ENVIRONMENT,
        stderr=-1,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    ) as run:
        until(lambda: len(processes(str(tmp_path / "results"))) == 2)
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=60)
    assert run.returncode == 130 and errors.strip() == "freeart21: stopped", errors
    assert not processes(str(tmp_path))
    assert not [path for path in tmp_path.rglob("*") if path.name.endswith((".part", ".lock", "lock"))]


STOPPED = (
    "import sys; from freeart21 import stopping; from test_jobs import chain, run_jobs, Path\n"
    "from freeart21.ending import report_errors\n"
    "stopping.listen()\n"
    "with report_errors(): run_jobs(Path(sys.argv[1]), chain(4, 60), 2)"
)


def test_a_command_ends_with_the_process_of_its_job_though_that_alone_is_killed(tmp_path):
    process = start_process(encode_request(tmp_path, writing(0, 60), "digest"))
    until(lambda: processes(str(tmp_path / "results")))
    process.kill()
    process.wait()
    until(lambda: not processes(str(tmp_path / "results")), 10)


def test_a_job_that_was_killed_between_its_statistics_and_its_marker_is_no_failure(tmp_path, monkeypatch):
    def killed(*_):
        raise RuntimeError

    job = writing(0, 0)
    run_jobs(tmp_path, [job])
    marker = tmp_path / ".jobs/done/write/0.json"
    before = results(tmp_path)
    marker.unlink()
    monkeypatch.setattr(Ledger, "finish", killed)
    with pytest.raises(RuntimeError):
        run_job(tmp_path, job, "digest")
    monkeypatch.undo()
    assert not marker.exists() and run_jobs(tmp_path, [job]).finished == ("write/0",)
    assert results(tmp_path) == before


def test_the_same_job_done_by_two_at_a_time_is_done_once(tmp_path):
    """As when a cluster still runs what a killed run had submitted."""
    job = writing(0, 0.3)
    both = [threading.Thread(target=run_job, args=(tmp_path, job, "digest")) for _ in range(2)]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    assert (tmp_path / "started_jobs.txt").read_text() == "text 0 "


# --- elsewhere --------------------------------------------------------------------------------------------------------


def test_submitits_own_executor_runs_them_to_the_same_bytes(tmp_path, whole):
    """No SLURM was at hand: submitit's local stand-in shows the wiring, not a cluster."""
    pytest.importorskip("submitit")
    bad = Job("bad", ("{python}", "-c", "import sys; sys.exit('no luck')"))
    report = run_jobs(tmp_path, [*chain(8), bad], executor=Slurm(4, tmp_path, "local"))
    assert len(report.finished) == 8 and [(f.name, f.reason) for f in report.failed] == [("bad", "no luck")]
    assert results(tmp_path) == whole


def test_rays_workers_killed_at_random_lose_nothing_and_do_nothing_twice(tmp_path, whole):
    ray = pytest.importorskip("ray")
    draw, killed, over = random.Random(2), [], threading.Event()

    def kill() -> None:
        while not over.is_set() and len(killed) < 4:
            time.sleep(draw.uniform(0.2, 0.6))
            workers = [pid for pid in processes("ray::run_in_process") if pid not in killed]
            if workers and started_jobs(tmp_path) > 1:
                killed.append(draw.choice(workers))
                with contextlib.suppress(ProcessLookupError):
                    os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        report = run_jobs(tmp_path, chain(8, 0.3), 2, "ray", attempts=20)
    finally:
        over.set()
        thread.join()
    assert killed and not report.failed and sorted(report.finished) == sorted(job.name for job in chain(8))
    assert not ray.is_initialized()
    local = tmp_path / "local"
    run_jobs(local, chain(8, 0.3), 2)
    assert results(tmp_path) == results(local)
    assert {p: h for p, h in results(tmp_path).items() if "done" not in p} == {
        p: h for p, h in whole.items() if "done" not in p
    }


def test_a_forecast_learns_from_what_jobs_took():
    jobs = [Job(f"{kind}/{k}", ("x",), seconds=10) for kind in "ab" for k in range(3)]
    forecast = Forecast(jobs, 2)
    assert forecast.remaining_s() == 30
    forecast.job_ended(jobs[0], 20.0)  # of kind a, twice its estimate
    assert forecast.remaining_s() == (2 * 20 + 3 * 10) / 2
    forecast.job_ended(jobs[3], None)  # failed: no measure
    assert forecast.remaining_s() == (2 * 20 + 2 * 10) / 2
