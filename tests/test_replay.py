"""`freeart21 replay`: files in, errors out, equal to `gap`'s to the last digit; bad files are one-line errors."""

from __future__ import annotations

import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, RATE, G, asset_of
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from freeart21 import cli
from freeart21.effects.detent import Detent
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.measured_writer import write_measured
from freeart21.joint import JointType
from freeart21.measured import Measured, Run
from simgap.prove.writeback import write_repaired
from simgap.replay import format_table, replay_folder

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


def test_a_replay_is_written_atomically_and_never_overwrites(tmp_path: Path):
    asset, runs = oiled(tmp_path), write_set(tmp_path / "m", pendulum(2))
    out = tmp_path / "out"
    result = replay_folder(asset, [runs / "swing_1.csv"], out)
    (row,) = result.rows
    assert row.replay.error < 1.1e-3 and row.replay.start == pytest.approx((STARTS[1], 0.0), abs=3e-3)
    curve = np.loadtxt(out / "curves/swing_1.csv", delimiter=",", skiprows=1)
    assert np.sqrt(np.mean((curve[:, 2] - curve[:, 1]) ** 2)) == pytest.approx(row.replay.error, rel=1e-9)
    data = json.loads((out / "replay.json").read_text())
    assert data["command"] == f"freeart21 replay {asset} {runs / 'swing_1.csv'}"
    assert set(data["asset"]["files"]) == {"bob.urdf", "bob.xml", "asset.json", "effects.json"}
    page = (out / "index.html").read_text()
    assert data["command"] in page and "swing_1" in page and "src=" not in page
    with pytest.raises(FreeArtError, match="exists; choose another place"):
        replay_folder(asset, [runs], out)
    with pytest.raises(FreeArtError, match="none of 2 runs was replayed within"):
        replay_folder(asset, [runs], tmp_path / "late", seconds=1e-3)
    assert not (tmp_path / "late").exists()


def test_engines_are_compared_or_the_reason_is_given(tmp_path: Path):
    pytest.importorskip("mujoco")
    runs = write_set(tmp_path / "m", pendulum(1))
    for asset in (oiled(tmp_path / "with"), tmp_path / "with/plain"):  # with an MJCF, and a URDF alone
        errors = [replay_folder(asset, [runs], engine=e).rows[0].replay.error for e in ("sapien", "mujoco")]
        assert errors[0] == pytest.approx(errors[1], rel=0.02)
    notched = oiled(tmp_path / "notched", Detent(0.3, 0.2, 0.05))
    with pytest.raises(FreeArtError, match="MuJoCo's format cannot say detent"):
        replay_folder(notched, [runs], engine="mujoco")


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


def slid(mm: bool = False) -> tuple[Run, ...]:
    """A drawer pushed once and stopped by dry friction of 1 N, in closed form."""
    t = np.arange(300) / RATE
    q = np.where(t < 2.0, 0.5 + 1.0 * t - 0.25 * t**2, 1.5)
    return (Run("pushed", t, q + np.random.default_rng(0).normal(0, 1e-3, len(t))),)


def test_each_joint_is_replayed_by_its_runs(tmp_path: Path):
    """A hinge and a slider of one asset, with millimetres in one file and missing rows in the other."""
    path = two(tmp_path / "a", '<dynamics friction="1.0"/>')
    (swing,) = pendulum(1, oil=0.0)
    seen = swing.q.copy()
    seen[40:90] = np.nan
    samples = np.r_[0:150, 220:300]
    hinge = write_set(tmp_path / "h", (replace(swing, times_s=swing.times_s[samples], q=seen[samples]),))
    slider = write_set(tmp_path / "s", slid(), "slide", "prismatic")
    text = json.loads((slider / "measured.json").read_text())
    text["units"]["q"] = "mm"
    (slider / "measured.json").write_text(json.dumps(text))
    rows = (slider / "pushed.csv").read_text().splitlines()
    scaled = [f"{t},{1e3 * float(q)}" for t, q in (row.split(",") for row in rows[1:])]
    (slider / "pushed.csv").write_text("\n".join([rows[0], *scaled]))
    result = replay_folder(path, [hinge, slider], tmp_path / "out")
    turned, pushed = result.rows
    assert turned.replay.error < 1.1e-3 and len(turned.replay.times_s) == 180
    assert pushed.replay.error < 1.1e-3 and pushed.replay.start == pytest.approx((0.5, 1.0), abs=3e-3)
    assert " rad" in format_table(result) and " mm/s" in format_table(result) and result.joint == "j, slide"
    assert len(list((tmp_path / "out/curves").iterdir())) == 2


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
