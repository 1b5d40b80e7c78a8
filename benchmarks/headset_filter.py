"""What the filter of a headset's takes costs and gives: a held controller's jitter against a fast one's lag.

    python -m benchmarks.headset_filter --mocap /path/to/mocap

prints a table for some settings; those of `freeart21.one_euro.headset_filter` are marked. The noise is assumed, not
measured (no headset was at hand): white, .3 mm and .1 degrees a sample and axis, and a hand's tremor at 10 Hz, .2 mm
and .1 degrees. Lag is of captured motion (ARCTIC's tracks, every third file, brought to a headset's 72 Hz by splines)
without noise: how long ago the filter's answer was true, by the part of its error along the motion. *Fast* are the
fastest 5 % of a take's samples, *else* those of the others that move by more than 2 cm/s or 11 degrees/s.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from benchmarks.common import make_table, run_cli
from freeart21 import se3
from freeart21.formats.captured import read_track
from freeart21.one_euro import Band, OneEuro, filter_motion, headset_filter
from freeart21.se3 import Array

HZ = 72.0
"""Frames a second of a headset: the least that the Quest and the PICO offer."""
TRIED = [headset_filter("revolute")] + [
    OneEuro(Band(low, p), Band(low, r), Band(low, r))
    for low, p, r in ((1, 0, 0), (1, 10, 1), (1, 30, 3), (1, 60, 5), (0.5, 100, 10), (3, 60, 5))
]


def main(mocap: Path) -> None:
    """Print the table; `mocap` is the folder of the tracks."""
    takes = [_at_headset_rate(path) for path in sorted(mocap.glob("*.npy"))[::3]]
    still = np.arange(0, 20, 1 / HZ)
    held = _noisy(still, np.random.default_rng(0))
    before = _spread(held)
    rows = []
    for settings in TRIED:
        assert settings.position is not None and settings.rotation is not None
        after = _spread(filter_motion(settings, still, held, np.zeros(len(still)))[0][int(HZ) :])
        lags = np.array([_lags(settings, *take) for take in takes])
        mark = " *" if settings is TRIED[0] else ""
        cutoff, betas = settings.position.min_cutoff_hz, f"{settings.position.beta:g}, {settings.rotation.beta:g}"
        noise = (f"{a:.3f} (/{b / a:.1f})" for a, b in zip(after, before, strict=True))
        rows.append((f"{cutoff:g}{mark}", betas, *noise, *(f"{ms:.0f}" for ms in np.median(lags, 0))))
    title = f"noise before: {before[0]:.2f} mm, {before[1]:.2f} degrees; {len(takes)} takes"
    head = ("min cutoff Hz", "beta 1/m, 1/rad", "held: mm", "degrees", "lag of places ms: fast", "else")
    Console(width=140).print(make_table(title, (*head, "of turns ms: fast", "else"), rows))


def _at_headset_rate(path: Path) -> tuple[Array, Array, Array]:
    take = read_track(path)
    times = np.arange(take.times[0], take.times[-1], 1 / HZ)
    turns = RotationSpline(take.times, Rotation.from_matrix(take.Ts[:, :3, :3]))(times).as_matrix()
    return (
        times,
        se3.pose(turns, CubicSpline(take.times, take.Ts[:, :3, 3])(times)),
        CubicSpline(take.times, take.states)(times),
    )


def _noisy(times: Array, rng: np.random.Generator) -> Array:
    tremor = np.sqrt(2) * np.sin(2 * np.pi * 10 * times[:, None] + rng.uniform(0, 2 * np.pi, 6))
    shift = 3e-4 * rng.normal(size=(len(times), 3)) + 2e-4 * tremor[:, :3]
    turn = np.radians(0.1) * (rng.normal(size=(len(times), 3)) + tremor[:, 3:])
    return se3.pose(se3.exp_so3(turn), shift)


def _spread(Ts: Array) -> tuple[float, float]:
    """Root mean square length of places, mm, and of turns, degrees."""
    lengths = [np.linalg.norm(v, axis=1) for v in (1e3 * Ts[:, :3, 3], np.degrees(se3.log_so3(Ts[:, :3, :3])))]
    mm, degrees = (float(np.sqrt(np.mean(length**2))) for length in lengths)
    return mm, degrees


def _lags(settings: OneEuro, times: Array, Ts: Array, states: Array) -> tuple[float, float, float, float]:
    """Median lag, ms, of fast places, others, fast turns, others."""
    out = filter_motion(settings, times, Ts, states)[0]
    R, back = Ts[:, :3, :3], np.swapaxes(Ts[:-1, :3, :3], 1, 2)
    v, w = HZ * np.diff(Ts[:, :3, 3], axis=0), HZ * se3.log_so3(R[1:] @ back)
    away = (Ts - out)[1:, :3, 3], se3.log_so3(R[1:] @ np.swapaxes(out[1:, :3, :3], 1, 2))
    lags = []
    for velocity, error, least in ((v, away[0], 0.02), (w, away[1], 0.2)):
        speed = np.linalg.norm(velocity, axis=1)
        late = 1e3 * (error * velocity).sum(1) / np.maximum(speed, 1e-9) ** 2
        fast = speed >= np.quantile(speed, 0.95)
        lags += [float(np.median(late[fast])), float(np.median(late[~fast & (speed > least)]))]
    return lags[0], lags[1], lags[2], lags[3]


if __name__ == "__main__":
    run_cli(main)
