"""`freeart21 replay`: files in, errors out, equal to `gap`'s to the last digit; bad files are one-line errors."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, RATE, G, asset_of
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from freeart21 import cli
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset
from freeart21.files.measured import write_measured
from freeart21.joint import JointType
from freeart21.measured import Measured, Run
from simgap.prove.writeback import write_repaired

OIL = 0.06
STARTS = (1.2, -0.7, 0.5, -1.0, 0.9, -0.4)


def pendulum(count: int = 6, oil: float = OIL, seconds: float = 3.0, noise: float = 1e-3) -> tuple[Run, ...]:
    """Swings of a pendulum by an independent equation."""
    rng, runs, t = np.random.default_rng(2), [], np.arange(round(seconds * RATE)) / RATE
    for i, q0 in enumerate(STARTS[:count]):

        def slope(_, y):
            return [y[1], (-MASS * G * ARM * np.sin(y[0]) - oil * y[1]) / INERTIA]

        q = solve_ivp(slope, (0, t[-1]), [q0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.01).y[0]
        runs.append(Run(f"swing_{i}", t, q + rng.normal(0, noise, len(t))))
    return tuple(runs)


def write_set(
    folder: Path, runs: tuple[Run, ...], joint: str = "j", kind: JointType = "revolute", down: ArrayLike = (0, 0, -G)
) -> Path:
    down = np.asarray(down, float)
    write_measured(folder, Measured(joint, kind, down, RATE, "recorded", None, None, 0.0, 0.0, runs, "unknown"))
    return folder


def oiled(folder: Path, *effects) -> Path:
    """The pendulum's asset with these effects, on disk."""
    return write_repaired(
        read_asset(asset_of(folder / "plain")), effects or (ViscousDamping(OIL),), folder / "oiled"
    ).urdf.parent


def run(*words: object) -> int | str | None:
    """Exit code of a command line, or its error line."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["freeart21", *map(str, words)])
        try:
            cli.main()
        except SystemExit as stop:
            return stop.code
    return 0


def test_gap_and_replay_agree_to_the_last_digit(tmp_path: Path, monkeypatch, capsys):
    """Before, after and in MuJoCo, by the verdict's own command lines."""
    monkeypatch.chdir(tmp_path)
    asset_of(Path("a")), write_set(Path("m"), pendulum())
    assert not run("gap", "a", "m", "--out", "gap")
    document = json.loads(Path("gap/verdict.json").read_text())
    assert document["verdict"] == "named" and [e["name"] for e in document["effects"]] == ["viscous_damping"]
    gap = {row["run"]: row for row in document["gap"]}
    assert gap and {row["use"] for row in gap.values()} == {"confirming"}
    page = Path("gap/index.html").read_text()
    witness = {row["run"]: row for row in document["proof"]["witness"].get("gap", ())}
    assert bool(witness) == bool(importlib.util.find_spec("mujoco"))
    for what, line in document["proof"]["repeat"].items():
        assert line in page
        for engine, rows in (
            ("sapien", gap),
            ("mujoco", {r["run"]: r for r in document["proof"]["witness"].get("gap", ())}),
        ):
            capsys.readouterr()
            out = f"{what}_{engine}"
            assert not run(*line.split()[1:], "--engine", engine, "--out", out)
            found = json.loads((Path(out) / "replay.json").read_text())
            errors = {row["run"]: row["error"] for row in found["runs"]}
            assert len(errors) == 6 and {name: row[what] for name, row in rows.items()} == {n: errors[n] for n in rows}
            printed = capsys.readouterr().out
            assert all(f"{row[what]:.6g} rad" in printed for row in rows.values())
            uses = {row["run"]: row["use"] for row in found["runs"]}
            assert uses == (document["uses"] if what == "after" else dict.fromkeys(uses, "unknown"))


INERTIA_TAG = '<inertia ixx="1e-2" iyy="1e-2" izz="1e-2" ixy="0" ixz="0" iyz="0"/>'
TWO = """<robot name="two"><link name="base"/>
    <link name="door"><inertial><origin xyz="0 0 -{ARM}"/><mass value="{MASS}"/>{tensor}</inertial></link>
    <link name="drawer"><inertial><mass value="2"/>{tensor}</inertial></link>
    <joint name="j" type="revolute"><parent link="base"/><child link="door"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3"/></joint>
    <joint name="slide" type="prismatic"><parent link="base"/><child link="drawer"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="5"/>{more}</joint></robot>"""


def two(folder: Path, more: str = "") -> Path:
    folder.mkdir(parents=True)
    path = folder / "two.urdf"
    path.write_text(TWO.format(ARM=ARM, MASS=MASS, tensor=INERTIA_TAG, more=more))
    return path


def test_bad_replay_files_are_a_one_line_error(tmp_path: Path):
    runs, path = write_set(tmp_path / "m", pendulum(2)), two(tmp_path / "a")
    loose = tmp_path / "loose.csv"
    loose.write_text((runs / "swing_0.csv").read_text())
    (tmp_path / "model.xml").write_text("<mujoco/>")
    mimic = tmp_path / "mimic.urdf"
    mimic.write_text(path.read_text().replace("</joint></robot>", '<mimic joint="j"/></joint></robot>'))
    elsewhere = write_set(tmp_path / "e", pendulum(1), "lid")
    unitless = write_set(tmp_path / "u", pendulum(1))
    text = json.loads((unitless / "measured.json").read_text())
    del text["units"]["q"]
    (unitless / "measured.json").write_text(json.dumps(text))
    (runs / "other.csv").write_text(loose.read_text())
    for words, message in (
        ((tmp_path / "model.xml", runs), "is of <mujoco>, expected a URDF's <robot>"),
        ((mimic, runs), "joint 'slide' follows 'j' (mimic)"),
        ((path, elsewhere), "no movable joint 'lid'; movable joints: j (revolute"),
        ((path, loose), "lies in none (measured.json): `freeart21 measure"),
        ((path, runs / "other.csv"), "names no run"),
        ((path, tmp_path / "gone"), "does not exist"),
        ((path, unitless), "has 'q', whose unit is not in 'units'"),
        ((tmp_path / "gone", runs), "does not exist"),
        ((path, runs, "--holding", "2"), "--holding 2.0, expected 0 to 1"),
        ((path,), "no run to replay"),
    ):
        code = run("replay", *words, "--out", tmp_path / "out")
        assert isinstance(code, str) and message in code and "\n" not in code, (words, code)
        assert not (tmp_path / "out").exists()
