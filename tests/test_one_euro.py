"""The one-euro filter against the paper's algorithm on numbers, and takes that ask for it."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from mutations import MUTATED, mutated_json, reads_or_refuses
from refusal import assert_refused

from freeart21 import se3
from freeart21.files.take import header_line, read_take, sample_line, write_take
from freeart21.formats.captured import read_track
from freeart21.one_euro import Band, OneEuro, filter_motion, headset_filter
from generator.motion import track

HEADSET = headset_filter("revolute")
BAND = Band(1.2, 0.7)
ALL = OneEuro(BAND, BAND, BAND, 0.9)
TIMES = 3 + np.cumsum(np.random.default_rng(1).uniform(0.002, 0.05, 300))  # as irregular as a radio link


def paper(values: np.ndarray, band: Band, speed_cutoff: float) -> np.ndarray:
    """Algorithm 1 of Casiez et al. (2012) on numbers, as printed."""

    def alpha(rate: float, cutoff: float) -> float:
        tau, te = 1 / (2 * math.pi * cutoff), 1 / rate
        return 1 / (1 + tau / te)

    out, dx_hat = [float(values[0])], 0.0
    for k in range(1, len(values)):
        rate = 1 / (TIMES[k] - TIMES[k - 1])
        dx = (values[k] - out[-1]) * rate
        a = alpha(rate, speed_cutoff)
        dx_hat = a * dx + (1 - a) * dx_hat
        a = alpha(rate, band.min_cutoff_hz + band.beta * abs(dx_hat))
        out.append(a * values[k] + (1 - a) * out[-1])
    return np.array(out)


def wandering(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses and states that hold, turn by whole turns and jump."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(len(TIMES), 6)) * rng.choice([0.001, 0.05, 0.5], (len(TIMES), 1))
    turns = [np.eye(3)]
    for w in steps[1:, 3:]:
        turns.append(turns[-1] @ se3.exp_so3(w))
    return se3.pose(np.array(turns), np.cumsum(steps[:, :3], 0)), np.cumsum(steps[:, 0])


def test_numbers_are_filtered_as_the_paper_says() -> None:
    Ts, states = wandering(0)
    Ts[:, 1:3, 3] = 0.2  # one coordinate moves: the vector's speed is its own
    _, smooth = filter_motion(OneEuro(None, None, BAND, 0.9), TIMES, Ts, states)
    np.testing.assert_allclose(smooth, paper(states, BAND, 0.9), atol=1e-12)
    out, _ = filter_motion(OneEuro(BAND, None, None, 0.9), TIMES, Ts, states)
    np.testing.assert_allclose(out[:, 0, 3], paper(Ts[:, 0, 3], BAND, 0.9), atol=1e-12)
    np.testing.assert_allclose(out[:, 1:3, 3], 0.2, atol=1e-12)


def test_a_turn_about_one_axis_is_filtered_as_its_angle_over_many_turns() -> None:
    angles = np.cumsum(np.abs(np.random.default_rng(2).normal(0.2, 0.1, len(TIMES))))  # 9 turns
    axis = np.array([2.0, -1, 2]) / 3
    Ts = se3.pose(se3.exp_so3(angles[:, None] * axis), np.zeros(3))
    out, _ = filter_motion(OneEuro(None, BAND, None, 0.9), TIMES, Ts, angles)
    expected = se3.exp_so3(paper(angles, BAND, 0.9)[:, None] * axis)
    np.testing.assert_allclose(out[:, :3, :3], expected, atol=1e-9)


def test_the_filter_knows_no_axes() -> None:
    Ts, states = wandering(3)
    out, _ = filter_motion(ALL, TIMES, Ts, states)
    A, B = se3.exp_se3([0.3, 0.1, -2, 1, 2, -0.5]), se3.pose(se3.exp_so3([0.4, -1, 2]), np.zeros(3))
    np.testing.assert_allclose(filter_motion(ALL, TIMES, A @ Ts @ B, states)[0], A @ out @ B, atol=1e-9)


def test_held_it_is_steadier_and_moved_it_follows() -> None:
    rng, n = np.random.default_rng(6), len(TIMES)
    noise = se3.pose(se3.exp_so3(0.002 * rng.normal(size=(n, 3))), 5e-4 * rng.normal(size=(n, 3)))
    held, _ = filter_motion(HEADSET, TIMES, noise, np.zeros(n))
    for part in (held[50:, :3, 3] / 5e-4, se3.log_so3(held[50:, :3, :3]) / 0.002):
        assert np.std(part) < 0.5
    path = np.sin(2 * (TIMES - TIMES[0]))[:, None]
    swept = se3.pose(se3.exp_so3(path * [0, 1.5, 0]), path * [0.3, 0, 0])
    out, _ = filter_motion(HEADSET, TIMES, swept, np.zeros(n))
    middle = np.abs(np.gradient(path[:, 0], TIMES)) > 1.5
    assert np.linalg.norm((out - swept)[middle, :3, 3], axis=1).max() < 0.02 * 0.6  # 20 ms of its speed
    assert se3.rotation_angle(out[middle, :3, :3] @ np.swapaxes(swept[middle, :3, :3], 1, 2)).max() < 0.02 * 3


# --- takes ------------------------------------------------------------------------------------------------------------


def _taken(path: Path, settings: OneEuro | None) -> np.ndarray:
    Ts, states = wandering(7)
    write_take(path, "a test", "camera", "revolute", zip(TIMES, Ts, states, strict=True), settings)
    return Ts


def test_a_take_s_filter_is_read_as_written_and_used_before_the_recorder_s_clock(tmp_path: Path) -> None:
    Ts = _taken(tmp_path / "a.jsonl", ALL)
    take = read_track(tmp_path / "a.jsonl")
    assert take.filter == ALL
    np.testing.assert_allclose(take.Ts, Ts, atol=1e-12)  # as it was taken
    count = track.count_frames(take, 30.0)
    smooth, smooth_states = filter_motion(ALL, take.times, take.Ts, take.states)
    plain = dataclasses.replace(take, Ts=smooth, states=smooth_states, filter=None)
    ours, expected = track.resample_take(take, 30.0, count), track.resample_take(plain, 30.0, count)
    assert np.array_equal(ours.Ts, expected.Ts) and np.array_equal(ours.states, expected.states)
    assert np.abs(ours.Ts - track.resample_take(dataclasses.replace(take, filter=None), 30.0, count).Ts).max() > 0.01


@pytest.mark.parametrize("settings", [HEADSET, None])
def test_no_filter_no_key_and_null_is_none(tmp_path: Path, settings: OneEuro | None) -> None:
    _taken(tmp_path / "a.jsonl", settings)
    assert read_take(tmp_path / "a.jsonl").filter == settings
    first, _, rest = (tmp_path / "a.jsonl").read_text().partition("\n")
    assert ("filter" in json.loads(first)) == (settings is not None)
    (tmp_path / "a.jsonl").write_text(json.dumps({**json.loads(first), "filter": None}) + "\n" + rest)
    assert read_take(tmp_path / "a.jsonl").filter is None


@MUTATED
@given(data=mutated_json({"one_euro": dataclasses.asdict(HEADSET)}))
def test_a_filter_is_read_or_refused_in_a_line(tmp_path: Path, data: object) -> None:
    head = {**json.loads(header_line("a test", "first", "revolute")), "filter": data}
    samples = [sample_line(k / 10, se3.pose(np.eye(3), [0, 0, 1]), 0.1 * k) for k in range(3)]
    (tmp_path / "a.txt").write_text("\n".join([json.dumps(head), *samples]))
    line = reads_or_refuses(read_track, tmp_path / "a.txt")
    assert not line or "a.txt" in line


def test_an_impossible_filter_is_refused(tmp_path: Path) -> None:
    _taken(tmp_path / "a.jsonl", OneEuro(None, None, Band(1.0, -1.0)))
    assert_refused("'state.beta' is -1, expected 0 to 10000", read_take, tmp_path / "a.jsonl")
