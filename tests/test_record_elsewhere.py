"""Sequences recorded as jobs of an executor: the bytes of the recorder's own, also when their processes are killed."""

import contextlib
import hashlib
import os
import signal
import threading
import time
from pathlib import Path

import pytest
from test_jobs import processes

from freeart21.errors import FreeArtError
from freeart21.jobs import EXECUTORS
from freeart21.jobs.executors import Local
from generator.dataset import Label, plan_jobs, record_jobs
from generator.session import RecordSettings

SMALL = RecordSettings(frames=6, width=64, height=48, queries=1, shader="trivial", edge=0.5)


def hashes(folder: Path) -> dict[str, str]:
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in found}


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch):
    monkeypatch.setitem(EXECUTORS, "elsewhere", Local)


def test_a_job_a_sequence_gives_the_bytes_of_one_process(tmp_path):
    jobs, heard = plan_jobs(["stapler", "flip_lighter"], SMALL), []
    record_jobs(tmp_path / "here", jobs, 1, Label("same"))
    over, killed = threading.Event(), []

    def kill() -> None:
        """Two of the jobs' processes, in the midst of their work."""
        while not over.is_set() and len(killed) < 2:
            work = tmp_path / "there" / ".recording"
            for pid in processes("freeart21.jobs.worker"):
                if pid not in killed and len(killed) < 2 and len(list(work.glob("*/side/*.png"))) > 2 * len(killed):
                    killed.append(pid)
                    with contextlib.suppress(ProcessLookupError):
                        os.killpg(pid, signal.SIGKILL)
            time.sleep(0.01)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        made = record_jobs(tmp_path / "there", jobs, 2, Label("same"), heard.append, "elsewhere")
    finally:
        over.set()
        thread.join()
    assert killed and sorted(made) == sorted(heard) == ["flip_lighter-s0", "stapler-s0"]
    assert hashes(tmp_path / "there") == hashes(tmp_path / "here")
    assert sorted(path.name for path in (tmp_path / "there").iterdir()) == ["benchmark.json", "sequences", "truth"]


def test_what_a_job_cannot_do_is_one_line_and_nothing_is_left(tmp_path, monkeypatch):
    (job,) = plan_jobs(["stapler"], SMALL)
    with pytest.raises(FreeArtError, match="unknown executor 'cloud'; executors: local, ray, slurm"):
        record_jobs(tmp_path / "data", [job], executor="cloud")
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nonexistent.json")
    monkeypatch.setattr("generator.dataset.require_rendering", lambda: None)  # here it would do; there it does not
    with pytest.raises(FreeArtError):
        record_jobs(tmp_path / "data", [job], executor="elsewhere")
    assert not (tmp_path / "data").exists()
