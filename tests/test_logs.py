"""Raw logs: wrapped angles, degrees, encoders of 0.1 degree, 10,000 rows/s."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import G, asset_of

from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured, write_measured
from freeart21.measured import BaseAxis, BaseSeries, Measured, Run
from freeart21.mechanics import Actuator
from freeart21.turns import is_wrapped
from simgap.measure.inputs import make_inputs
from simgap.measure.noise import estimate_noise
from simgap.models.surrogate import make_plant, simulate

TIMES = np.arange(400) / 100
ROUND = 3.0 + 2.5 * TIMES + np.sin(3 * TIMES)
"""Positions (rad) of a continuous joint over one and a half turns."""


def within(q: np.ndarray) -> np.ndarray:
    """Wrapped to -180 to 180 degrees."""
    return (q + np.pi) % (2 * np.pi) - np.pi


def measured_of(q: np.ndarray, **more) -> Measured:
    run = Run("r", TIMES, q, **more)
    law = Actuator(None, 3.0, 0.1) if "q_command" in more else None
    return Measured("j", "revolute", np.array([0, 0, -G]), 100.0, "recorded", None, law, runs=(run,))


def write_and_read(folder: Path, measured: Measured, **words) -> Measured:
    """The set read back with these additional keys in measured.json."""
    write_measured(folder, measured)
    path = folder / "measured.json"
    data = json.loads(path.read_text())
    for key, value in words.items():
        data[key] = {**data[key], **value} if isinstance(value, dict) else value
    path.write_text(json.dumps(data))
    return read_measured(folder)


def test_wrapped_angles_are_unwrapped_and_reported(tmp_path: Path):
    wrapped = measured_of(within(ROUND))
    for name, words in (("told", {"wrapped": True}), ("clear", {})):
        read = write_and_read(tmp_path / name, wrapped, **words)
        np.testing.assert_allclose(read.runs[0].q - read.runs[0].q[0], ROUND - ROUND[0], atol=1e-9)
        (note,) = read.notes
        assert note.startswith("run 'r': angles were within one turn and have been unwrapped, 2 jumps")
        assert ('"wrapped": false' in note) is (name == "clear")
    raw = write_and_read(tmp_path / "no", wrapped, wrapped=False)
    np.testing.assert_array_equal(raw.runs[0].q, within(ROUND))
    assert raw.notes == ()


def test_commands_follow_positions_and_gaps_remain(tmp_path: Path):
    q = within(ROUND)
    q[100:103] = np.nan
    read = write_and_read(tmp_path / "a", measured_of(q, q_command=within(ROUND + 0.2)), wrapped=True)
    run = read.runs[0]
    assert run.q_command is not None and np.isnan(run.q[100:103]).all()
    np.testing.assert_allclose((run.q_command - run.q)[103:], 0.2, atol=1e-9)


@pytest.mark.parametrize("q", [
    within(ROUND) * (np.abs(within(ROUND)) < 1), 3.5 * np.sin(TIMES),
    np.where(TIMES < 2, -3.0, 3.0) + 0.5 * np.sin(9 * TIMES),
    3 * np.sign(np.sin(40 * TIMES)),
])  # fmt: skip
def test_ambiguous_wraps_are_left_alone(q: np.ndarray):
    assert not is_wrapped(q) and is_wrapped(within(ROUND))


def test_declared_degrees_apply_to_every_column(tmp_path: Path):
    axis = BaseAxis(np.array([0, 0, 1.0]), np.zeros(3))
    base, rates = BaseSeries(angle=0.2 * np.sin(TIMES)), 0.3 * np.cos(3 * TIMES)
    measured = replace(measured_of(0.1 * np.sin(3 * TIMES), q_command=0.2 * TIMES, base=base, qd=rates), base_axis=axis)
    units = {"q": "deg", "q_command": "deg", "base_angle": "deg", "qd": "deg/s"}
    read = write_and_read(tmp_path / "a", measured, units=units).runs[0]
    plain = write_and_read(tmp_path / "b", measured).runs[0]
    assert read.base is not None and plain.base is not None
    for ours, theirs in ((read.q, plain.q), (read.q_command, plain.q_command), (read.qd, plain.qd),
                         (read.base.angle, plain.base.angle)):  # fmt: skip
        np.testing.assert_allclose(ours, np.radians(theirs), rtol=1e-12)
    np.testing.assert_array_equal(plain.qd, rates)
    slide = replace(measured_of(TIMES), joint_type="prismatic")
    np.testing.assert_allclose(write_and_read(tmp_path / "c", slide, units={"q": "mm"}).runs[0].q, TIMES / 1000)


@pytest.mark.parametrize("rate", [10, 100, 1000, 10_000])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_noise_floor_of_a_coarse_encoder(rate: int, noise: float):
    """In degrees; a decaying swing and a fast one."""
    rng, step = np.random.default_rng(rate), 0.1
    times = np.arange(20 * rate) / rate
    for size, freq in ((30.0, 0.7), (4.0, 0.3)):
        q = size * np.exp(-0.1 * times) * np.sin(2 * np.pi * freq * times)
        read = np.radians(step * np.round((q + noise * rng.normal(size=len(q))) / step))
        true = np.radians(np.hypot(step / np.sqrt(12), noise))
        estimate = estimate_noise([(times, read)])
        assert 0.8 * true < estimate.sigma_at_rest < 1.6 * true
        assert estimate.time_jitter_s < 5e-3


def test_10_khz_commands_are_averaged(tmp_path: Path):
    rate = 10_000
    times = np.arange(3 * rate) / rate
    effort = 3 * np.sin(5 * times) + 2 * np.sign(np.sin(23 * times)) + 2 * np.sin(900 * times)
    enabled = (times < 1.23456).astype(float)
    run = Run("r", times, 0 * times, effort, enabled=enabled)
    measured = Measured("j", "revolute", np.array([0, 0, -G]), rate, "recorded", "commanded", runs=(run,))
    plant = make_plant(read_asset(asset_of(tmp_path)), measured)
    fine, coarse = make_inputs(run, measured), make_inputs(run, measured, 0.02)
    assert len(coarse.times_s) < 400 and len(fine.times_s) > 10_000
    ways = [simulate(plant, (), times[::50], 0.2, 0.0, variant) for variant in (fine, coarse)]
    assert np.abs(ways[0] - ways[1]).max() < 2e-3 * np.ptp(ways[0])
    assert np.abs(simulate(plant, (), times[::50], 0.2) - ways[0]).max() > 0.1


def test_a_minute_at_10_khz_fits_in_a_gigabyte(tmp_path: Path):
    """Checks memory; time is documented."""
    rate = 10_000
    times = np.arange(60 * rate) / rate
    q = np.radians(0.1) * np.round(0.5 * np.sin(3 * times) / np.radians(0.1))
    table = np.stack([times, q, 2 * np.sin(2 * times)], 1)
    write_measured(tmp_path / "set", Measured("j", "revolute", np.array([0, 0, -G]), rate, "recorded", "commanded",
        runs=(Run("r", times[:100], q[:100], q[:100]),)))  # fmt: skip
    with (tmp_path / "set" / "r.csv").open("w") as file:
        file.write("t_s,q,effort\n")
        np.savetxt(file, table, fmt="%.9g", delimiter=",")
    code = f"""
from pathlib import Path
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from simgap.measure.data import make_fit_runs, thinning_notes
from simgap.models.surrogate import make_plant
measured = read_measured(Path({str(tmp_path / "set")!r}))
runs, sensor = make_fit_runs(measured, make_plant(read_asset(Path({str(asset_of(tmp_path))!r})), measured))
memory = int(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0]) / 2**20  # its own, no parent's
print(memory, len(runs[0].q), len(runs[0].inputs.times_s), sensor.sigma_at_rest)
print(thinning_notes(measured)[0])
"""
    done = subprocess.run(["sh", "-c", 'exec "$0" -c "$1"', sys.executable, code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    numbers, note = done.stdout.splitlines()
    memory, readings, inputs, still = map(float, numbers.split())
    assert memory < 1.0 and readings <= 6000 and inputs < 10_000
    assert 0.9 < still / np.radians(0.1 / np.sqrt(12)) < 1.6
    assert note == "run 'r': one reading of 400 is looked at, 25 of 1e+04 a second"
