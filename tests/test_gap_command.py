"""`freeart21 gap` on bad input: one line, exit code 1, no output left behind."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gap_case import asset_of
from test_measured import write

from freeart21 import cli, se3

RATE = 0.01
TIMES = RATE * np.arange(120)


def series(q) -> str:
    return "t_s,q\n" + "\n".join(f"{RATE * i:.6f},{v:.9f}" for i, v in enumerate(q))


def swing(amplitude: float = 0.5) -> np.ndarray:
    return amplitude * np.cos(5.3 * TIMES) + 1e-3 * np.sin(997 * TIMES)


def poses(folder: Path, q, axis=(0, 1, 0)) -> None:
    """Noisy poses of the pendulum's bob turned by `q` (n,) about `axis` through the joint's origin."""
    folder.mkdir(parents=True)
    pivot = se3.pose(np.eye(3), [0, 0, 1])
    turned = pivot @ se3.exp_se3(np.outer(q, [0, 0, 0, *axis])) @ se3.inverse(pivot)
    shaken = turned @ se3.exp_se3(np.random.default_rng(0).normal(size=(len(q), 6)) * 1e-3)
    np.savez(folder / "poses.npz", T_camera_reference=np.tile(np.eye(4), (len(q), 1, 1)), T_camera_moving=shaken)


def gap(folder: Path, monkeypatch, capsys) -> tuple[int | str | None, str]:
    """Exit code (0 for none) and the last line of output."""
    monkeypatch.setattr(
        sys, "argv", ["freeart21", "gap", *(str(folder / n) for n in ("a", "m")), "--out", str(folder / "out")]
    )
    code: int | str | None = 0
    try:
        cli.main()
    except SystemExit as stop:
        code = stop.code or 0
    return code, capsys.readouterr().out


POSES: dict[str, Any] = {"runs": [{"file": "p", "kind": "poses"}]}
ONE: dict[str, Any] = {"runs": [{"file": "run_0.csv"}]}
BAD = [
    (ONE, series(swing()[:5]), "has 5 samples, expected 20 or more: the run is too short"),
    (
        {**ONE, "joint": "hinge"},
        series(swing()),
        "no movable joint 'hinge'; movable joints: j (revolute -172..172 deg)",
    ),
    (
        {**ONE, "joint_type": "prismatic", "units": {"t_s": "s", "q": "m"}},
        series(swing()),
        "joint 'j' is revolute, but the measurement says prismatic",
    ),
    (ONE, series(57.3 * swing()), "joint 'j' has limits -3 to 3 rad: are its units degrees?"),
    ({"runs": [*ONE["runs"], {**POSES["runs"][0], "held_out": True}]}, series(swing()), "(p) are held out"),
]


@pytest.mark.parametrize(("changes", "csv", "message"), BAD, ids=range(len(BAD)))
def test_bad_input_is_a_one_line_error_without_output(tmp_path: Path, monkeypatch, capsys, changes, csv, message):
    asset_of(tmp_path / "a")
    write(tmp_path / "m", changes, csv=csv)
    poses(tmp_path / "m/p", swing())
    code, _ = gap(tmp_path, monkeypatch, capsys)
    assert isinstance(code, str) and code.startswith("freeart21: ") and message in code and "\n" not in code
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "m"]


def test_one_short_sweep_of_poses_is_accepted(tmp_path: Path, monkeypatch, capsys):
    asset_of(tmp_path / "a")
    write(tmp_path / "m", POSES)
    poses(tmp_path / "m/p", np.linspace(0, 1, 20))
    code, out = gap(tmp_path, monkeypatch, capsys)
    assert code == 0 and out
    assert (tmp_path / "out/verdict.json").is_file() and (tmp_path / "out/index.html").is_file()
