"""Recordings of real pendula are read unchanged; skipped where they are not available."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real_recordings import MEASURED, recordings
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from freeart21.formats.measured_series import SeriesSettings, measure_series

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
    words, options, count, rate_hz = COMMANDS[name]
    files = [MEASURED / word for word in words.split()]
    if not all(file.is_file() for file in files):
        pytest.skip("this recording is not at hand")
    notes = measure_series(
        files, tmp_path / "out", sets / next(iter(SOURCES)) / "asset.urdf", None, SeriesSettings(**options)
    )
    measured = read_measured(tmp_path / "out" / "measured")
    assert len(measured.runs) == count and measured.rate_hz == pytest.approx(rate_hz, rel=0.1)
    assert any("times are" in note for note in notes) and all("\n" not in note for note in notes)
