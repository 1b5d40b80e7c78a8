"""Recordings of real pendula are read unchanged; skipped where they are not available."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real_recordings import SHARED, recordings
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from freeart21.formats.measured_series import SeriesSettings, measure_series
from generator.simulate import roll_out

SOURCES = {name: make for name, make in recordings().items() if name in ("multiarm", "bam_kp100", "bam_kp400", "dfki")}
pytestmark = pytest.mark.skipif(not SOURCES, reason="recordings of others are not at hand")


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("real")
    for name, make in SOURCES.items():
        (folder / name).mkdir()
        make(folder / name)
    return folder


@pytest.mark.parametrize("name", SOURCES)
def test_real_recordings_are_read_with_their_asset(name: str, sets: Path):
    measured = read_measured(sets / name / "measured")
    asset = read_asset(sets / name / "asset.urdf", measured.joint)
    assert asset.joint == measured.joint == "hinge"
    assert any(run.held_out for run in measured.runs) and not all(run.held_out for run in measured.runs)
    assert all(np.isfinite(run.q).all() and len(run.q) > 100 for run in measured.runs)
    assert (measured.actuator is not None) == name.startswith("bam")


def test_the_free_arm_swings_at_its_assets_frequency(sets: Path):
    run = read_measured(sets / "multiarm" / "measured").runs[0]
    asset = read_asset(sets / "multiarm" / "asset.urdf")
    turns = np.flatnonzero(np.diff(np.sign(run.q)) > 0)
    period = float(np.diff(run.times_s[turns])[-3:].mean())
    amplitude = float(np.abs(run.q[turns[-2] : turns[-1]]).max())
    alone = roll_out(asset, amplitude, duration_s=2.0)
    crossings = np.flatnonzero(np.diff(np.sign(alone.q)) > 0)
    assert float(np.diff(alone.times_s[crossings])[0]) == pytest.approx(period, rel=0.03)


def test_a_disabled_servo_has_no_commands(sets: Path):
    measured = read_measured(sets / "bam_kp100" / "measured")
    free = [run for run in measured.runs if run.q_command is None]
    assert len(free) == 1 and len(measured.runs) == 5
    assert free[0].times_s[-1] - free[0].times_s[0] == pytest.approx(4.0, abs=0.5)  # let go for four seconds
    assert measured.actuator is not None and 0.1 < measured.actuator.stiffness < 0.3


COMMANDS = {  # files, required options, runs, rows a second
    "two headers": ("phy180_pendulum/data31.csv phy180_pendulum/data2_14.csv", {"unit_q": "rad"}, 2, 230),
    "its torque": ("dfki_pendulum/sysid_measured.csv", {"effort": "commanded", "unit_q": "rad"}, 1, 300),
    "JSON logs": (
        "bam_xl330/kp100_lift_and_drop.json bam_xl330/kp100_sin_sin.json",
        {"actuator": (0.2, 0.03), "unit_q": "rad"},
        3,
        189,
    ),
    "cells": (
        "multiarm_pendulum/SinglePendulumDataForParameterEstimation.mat",
        {"columns": {"t": "Time_id", "q": "Y_id:1"}, "zero": np.pi},
        4,
        1000,
    ),
    "a matrix": (
        "hsm150_motor/idf_pos_0.06_1.mat",
        {"columns": {"t": "data:1", "q": "data:3"}, "unit_q": "deg"},
        1,
        1000,
    ),
    "no header": ("directdrive_friction/test2/cin_pos1_01_exp_gan.t", {"unit_q": "deg"}, 1, 66.7),
    "vectors": ("rotary_and_cart/adip_pend_data.mat", {"unit_q": "rad"}, 1, 1000),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_each_recording_imports_with_one_command(name: str, sets: Path, tmp_path: Path):
    words, told, count, rate_hz = COMMANDS[name]
    files = [SHARED / word for word in words.split()]
    if not all(file.is_file() for file in files):
        pytest.skip("this recording is not at hand")
    notes = measure_series(
        files, tmp_path / "out", sets / next(iter(SOURCES)) / "asset.urdf", None, SeriesSettings(**told)
    )
    measured = read_measured(tmp_path / "out" / "measured")
    assert len(measured.runs) == count and measured.rate_hz == pytest.approx(rate_hz, rel=0.1)
    assert any("times are" in note for note in notes) and all("\n" not in note for note in notes)
