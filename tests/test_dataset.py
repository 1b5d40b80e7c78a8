"""Whole data sets: one writer, any number of workers, killed at any moment, and the same bytes in the end."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import functools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from another_python import ROOT, run_python
from test_jobs import job_processes

from freeart21 import catalog
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import read_benchmark
from freeart21.files.data_card import CARD_FILES
from freeart21.files.hashes import file_sha256
from freeart21.files.truth import read_truth
from freeart21.files.verify import verify
from freeart21.jobs import EXECUTORS, Local
from generator import dataset
from generator.dataset import official_names, plan_jobs, procedural_jobs, record_jobs
from generator.session import RecordSettings

SETTINGS = RecordSettings(frames=6, width=160, height=120, queries=2, shader="trivial", edge=0.5)
RUN = [sys.executable, "-c", "from freeart21.cli import main; main()"]
SMALL = ["--frames", "6", "--width", "160", "--height", "120", "--queries", "2", "--shader", "trivial"]


def hashes(data: Path) -> dict[str, str]:
    """File name to hash of everything in a folder, hidden files too."""
    return {str(p.relative_to(data)): file_sha256(p) for p in sorted(data.rglob("*")) if not p.is_dir()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences, recorded without interruption."""
    data = tmp_path_factory.mktemp("whole") / "data"
    assert record_jobs(data, plan_jobs(["stapler", "flip_lighter"], SETTINGS)) == ["stapler-s0", "flip_lighter-s0"]
    return data


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sequence."""
    data = tmp_path_factory.mktemp("one") / "data"
    record_jobs(data, plan_jobs(["flip_lighter"], SETTINGS))
    return data


# --- interrupted ------------------------------------------------------------------------------------------------------


def test_a_kill_between_the_renames_is_repaired(one: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs, data = plan_jobs(["flip_lighter"], SETTINGS), tmp_path / "data"
    rename = Path.replace

    def stopping(self: Path, target: Path) -> Path:
        if Path(target) == data / "sequences" / "flip_lighter-s0":
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "replace", stopping)
        record_jobs(data, jobs)
    assert (data / "truth" / "flip_lighter-s0").is_dir() and not (data / "sequences" / "flip_lighter-s0").exists()
    record_jobs(data, jobs)
    assert hashes(data) == hashes(one)


def test_a_recorder_that_is_killed_goes_on_to_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    code = (
        "import sys; from pathlib import Path; from test_dataset import SETTINGS, plan_jobs, record_jobs\n"
        "record_jobs(Path(sys.argv[1]), plan_jobs(['stapler', 'flip_lighter'], SETTINGS))"
    )
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
    running = subprocess.Popen([sys.executable, "-c", code, data], env=environment)
    while running.poll() is None and len(list(data.glob(".recording/*/side/*.png"))) < 2:
        time.sleep(0.005)
    running.kill()
    assert running.wait() == -signal.SIGKILL and not (data / "benchmark.json").exists()
    assert record_jobs(data, plan_jobs(["stapler", "flip_lighter"], SETTINGS))
    assert hashes(data) == hashes(whole)


def test_ctrl_c_says_in_one_line_how_to_go_on(tmp_path: Path) -> None:
    data = tmp_path / "data"
    names = ["stapler", "flip_lighter", "drawer_unit", "swivel_usb", "slider_phone", "office_scissors"]  # long enough
    command = [*RUN, "record", *names, "--out", str(data), *SMALL, "--workers", "2"]
    heeded = functools.partial(signal.signal, signal.SIGINT, signal.default_int_handler)  # shells let '&' ignore it
    running = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, preexec_fn=heeded)
    deadline = time.monotonic() + 90
    while len(list(data.glob(".recording/*/object"))) < 1 and time.monotonic() < deadline:
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 130, errors
    assert len(errors.strip().splitlines()) == 1 and "the same command goes on" in errors
    assert (data / ".recording" / "job.json").is_file()
    with dataset._writer_lock(data):  # no worker of it is left
        pass


# --- workers ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXECUTORS, "elsewhere", Local)


def test_jobs_of_an_executor_give_the_same_bytes_also_when_their_processes_are_killed(
    whole: Path, tmp_path: Path, elsewhere: None
) -> None:
    jobs, data, heard = plan_jobs(["stapler", "flip_lighter"], SETTINGS), tmp_path / "data", []
    over, killed = threading.Event(), []

    def kill() -> None:
        """Two of the jobs' processes, in the midst of their work."""
        while not over.is_set() and len(killed) < 2:
            work = data / ".recording"
            for pid in job_processes(str(data)):
                if pid not in killed and len(killed) < 2 and len(list(work.glob("*/side/*.png"))) > 2 * len(killed):
                    killed.append(pid)
                    with contextlib.suppress(ProcessLookupError):
                        os.killpg(pid, signal.SIGKILL)
            time.sleep(0.01)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        made = record_jobs(data, jobs, 2, on_done=heard.append, executor="elsewhere")
    finally:
        over.set()
        thread.join()
    assert killed and sorted(made) == sorted(heard) == ["flip_lighter-s0", "stapler-s0"]
    assert hashes(data) == hashes(whole)
    assert {path.name for path in data.iterdir()} == {"benchmark.json", "sequences", "truth", *CARD_FILES}


def test_what_a_job_cannot_do_is_one_line_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, elsewhere: None
) -> None:
    (job,) = plan_jobs(["stapler"], SETTINGS)
    with pytest.raises(FreeArtError, match="unknown executor 'cloud'; executors: local, ray, slurm"):
        record_jobs(tmp_path / "data", [job], executor="cloud")
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nonexistent.json")
    monkeypatch.setattr("generator.dataset.require_rendering", lambda: None)  # here it would do; there it does not
    with pytest.raises(FreeArtError):
        record_jobs(tmp_path / "data", [job], executor="elsewhere")
    assert not (tmp_path / "data").exists()


# --- one writer, one plan ---------------------------------------------------------------------------------------------


def test_two_writers_on_one_folder_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset, "_PATIENCE_S", 0.2)
    data = tmp_path / "data"
    with dataset._writer_lock(data):
        with pytest.raises(FreeArtError, match="another process is recording into .*data; wait for it"):
            record_jobs(data, plan_jobs(["stapler"], SETTINGS))
        other = (
            "import sys; from pathlib import Path; from generator import dataset; dataset._PATIENCE_S = 0.2\n"
            "with dataset._writer_lock(Path(sys.argv[1])): pass"
        )
        done = run_python("-c", other, data)
        assert done.returncode != 0 and "another process is recording" in done.stderr
    assert not data.exists()  # nothing was made, nothing is left


def test_a_truth_in_place_of_other_settings_is_refused_saying_what_differs(one: Path, tmp_path: Path) -> None:
    """A recording that was killed between the two renames is not finished with another plan."""
    data = tmp_path / "data"
    shutil.copytree(one / "truth", data / "truth")
    (data / ".recording" / "flip_lighter-s0").mkdir(parents=True)
    with pytest.raises(FreeArtError, match="flip_lighter-s0 exists with frames 6, not 7; choose another"):
        record_jobs(data, plan_jobs(["flip_lighter"], dataclasses.replace(SETTINGS, frames=7)))


def test_a_whole_data_set_is_left_alone_and_can_grow(whole: Path, one: Path, tmp_path: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*")}
    assert record_jobs(whole, plan_jobs(["flip_lighter", "stapler"], SETTINGS)) == []
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("*")} == before
    data = Path(shutil.copytree(one, tmp_path / "data"))
    record_jobs(data, plan_jobs(["stapler"], SETTINGS))
    assert hashes(data) == hashes(whole)
    with pytest.raises(FreeArtError, match="stapler-s0 exists with frames 6, not 9"):
        record_jobs(data, plan_jobs(["stapler"], dataclasses.replace(SETTINGS, frames=9)))
    assert read_benchmark(data).sequences == ("flip_lighter-s0", "stapler-s0")


# --- the disk ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", ["poses.npz", "benchmark.json"])
def test_a_full_disk_is_one_line_and_the_same_call_goes_on(
    one: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    jobs, data = plan_jobs(["flip_lighter"], SETTINGS), tmp_path / "data"
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with monkeypatch.context() as patch, pytest.raises(atomic.CannotWrite) as caught:
        mkstemp, savez = tempfile.mkstemp, np.savez_compressed

        def no_room(**where: object) -> tuple[int, str]:
            if str(where["prefix"]).startswith(f".{at}"):
                raise full
            return mkstemp(**where)  # type: ignore[call-overload,no-any-return]

        def no_room_for_arrays(path: Path, **arrays: object) -> None:
            if Path(path).name == at:
                raise full
            savez(path, **arrays)  # type: ignore[arg-type]

        patch.setattr(tempfile, "mkstemp", no_room)
        patch.setattr(np, "savez_compressed", no_room_for_arrays)
        record_jobs(data, jobs)
    line = str(caught.value)
    assert "\n" not in line and "No space left on device" in line and str(data / dataset.WORK) in line
    assert "cannot write" in line and "run the same command again" in line
    for sequence in data.glob("sequences/*"):
        assert hashes(sequence) == hashes(one / "sequences" / sequence.name)
    record_jobs(data, jobs)
    assert hashes(data) == hashes(one)


# --- which sequences --------------------------------------------------------------------------------------------------


def test_fresh_objects_of_a_category_vary_and_follow_from_the_seed() -> None:
    jobs = procedural_jobs("stapler", 30, 7, SETTINGS)
    assert [j.sequence for j in jobs[:2]] == ["stapler-s7-000", "stapler-s7-001"]
    assert {j.name for j in jobs} == {e.name for e in catalog.CATALOG if e.category == "Stapler" and not e.benchmark}
    assert len({j.settings.seed for j in jobs}) == 30
    assert procedural_jobs("Stapler", 5, 7, SETTINGS) == jobs[:5]
    assert procedural_jobs("Stapler", 5, 8, SETTINGS) != jobs[:5]
    with pytest.raises(FreeArtError, match="unknown category 'Teapot'; procedural categories: USB, Lighter"):
        procedural_jobs("Teapot", 1, 0, SETTINGS)


def test_official_objects_that_are_absent_are_named_in_one_line_with_where_to_ask(tmp_path: Path) -> None:
    with pytest.raises(FreeArtError, match=r"21 of FreeArt-21's 21 .* 100109, .*https://sapien.ucsd.edu/downloads"):
        official_names(tmp_path)
    with pytest.raises(FreeArtError) as none:
        official_names(tmp_path, skip_missing=True)
    assert "--skip-missing" not in str(none.value)  # there is nothing that it would leave
    for place in (tmp_path / "45135", tmp_path / "dataset" / "103271"):  # as the data set unpacks, too
        place.mkdir(parents=True)
        (place / "mobility.urdf").write_text("<robot/>")
    with pytest.raises(FreeArtError, match="19 of FreeArt-21's 21 .*--skip-missing") as caught:
        official_names(tmp_path)
    assert "45135" not in str(caught.value) and "\n" not in str(caught.value)
    assert official_names(tmp_path, skip_missing=True) == ("103271", "45135")


# --- what is recorded -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", ["noise2", "hand"])
def test_other_sensors_keep_the_truth_and_the_views_clean(whole: Path, tmp_path: Path, sensor: str) -> None:
    record_jobs(tmp_path, plan_jobs(["stapler"], dataclasses.replace(SETTINGS, sensor=sensor)))
    assert verify(tmp_path).findings == []
    mine, clean = hashes(tmp_path), hashes(whole)
    views = [name for name in clean if "stapler-s0/queries/" in name]
    assert len(views) == 4 and all(mine[name] == clean[name] for name in views)
    assert mine["sequences/stapler-s0/depth/00003.png"] != clean["sequences/stapler-s0/depth/00003.png"]


def test_a_released_joint_swings_by_the_effects_given_while_the_rest_stands_still(tmp_path: Path) -> None:
    def released(coefficient: float, data: Path) -> np.ndarray:
        effects = tmp_path / "effects.json"
        atomic.write_json(
            effects,
            {"schema": "freeart21/effects/1", "joints": {"joint_0": [ViscousDamping(coefficient).to_json("revolute")]}},
        )
        settings = dataclasses.replace(SETTINGS, frames=30, motion="release", effects=effects, width=64, height=48)
        record_jobs(data, plan_jobs(["flip_lighter"], settings))
        truth = read_truth(data / "truth" / "flip_lighter-s0")
        assert np.ptp(truth.Ts_camera_reference, axis=0).max() < 1e-9
        assert truth.source["settings"]["effects"]["joints"]["joint_0"] == [
            ViscousDamping(coefficient).to_json("revolute")
        ]
        return truth.states

    free, damped = released(0.0, tmp_path / "free"), released(1e-3, tmp_path / "damped")
    assert free[0] == damped[0] and np.ptp(free) > 0.5
    assert np.abs(np.diff(damped)).max() < 0.5 * np.abs(np.diff(free)).max()
