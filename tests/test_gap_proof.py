"""Claims of `gap` hold for the delivered files, on motions integrated by independent equations."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from gap_case import ARM, INERTIA, MASS, RATE, G, asset_of, measured_of, problem_of
from scipy.integrate import solve_ivp

from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured, write_measured
from freeart21.joint import JointType
from freeart21.measured import Measured, Run
from simgap.models.surrogate import Nuisance, make_plant
from simgap.prove.body import find_correction
from simgap.prove.replay import AssetOnDisk, replay
from simgap.prove.writeback import write_repaired
from simgap.select.decide import _confirm
from simgap.settings import JudgementSettings
from simgap.verdict import NamedEffect, RunGap, Use, Verdict
from simgap.workflow import gap_folder


def slider(folder: Path, mass: float) -> Path:
    """The URDF of a point mass on a free slider along x."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "ball.urdf"
    path.write_text(f"""<robot name="ball"><link name="base"/><link name="ball"><inertial><mass value="{mass}"/>
        <inertia ixx="1e-8" iyy="1e-8" izz="1e-8" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="prismatic"><parent link="base"/><child link="ball"/><axis xyz="1 0 0"/></joint>
        </robot>""")
    return path


def tree(folder: Path, kind: str, axis: str) -> Path:
    """URDF of two links after a joint and a third before it, all frames rotated."""
    folder.mkdir(parents=True, exist_ok=True)
    inertial = """<inertial><origin xyz="{}" rpy="0.3 0.2 0.1"/><mass value="{}"/>
        <inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="0.001" ixz="0" iyz="0.002"/></inertial>"""
    path = folder / "tree.urdf"
    path.write_text(f"""<robot name="tree"><link name="base">{inertial.format("0 0 0", 3)}</link><link name="arm">
        {inertial.format("0.1 0.05 -0.3", 1.5)}</link><link name="tip">{inertial.format("0 0.1 0.05", 0.4)}</link>
        <joint name="j" type="{kind}"><parent link="base"/><child link="arm"/><origin xyz="0.1 0 1" rpy="0 0.3 0"/>
        <axis xyz="{axis}"/><limit lower="-1" upper="2"/></joint>
        <joint name="k" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 -0.5" rpy="1 0 0.3"/>
        </joint></robot>""")
    return path


def free(kind: JointType, *runs: Run, doubt: tuple[float, float] = (0.1, 0.05), gravity: float = G) -> Measured:
    """A measured set of these undriven runs."""
    down = np.array([0.0, 0.0, -gravity])
    return Measured("j", kind, down, RATE, "recorded", None, None, *doubt, runs, "unknown")


@pytest.mark.parametrize(
    ("kind", "axis"), [("revolute", "0.2 2 0.4"), ("revolute", "0.3 0 1"), ("prismatic", "0.2 0.1 1")]
)
@pytest.mark.parametrize("nuisance", [Nuisance(1.09), Nuisance(0.92, 0.97), Nuisance(1.05, 1.03, (0.02, -0.01))])
def test_a_corrected_body_moves_as_fitted(kind: JointType, axis: str, nuisance: Nuisance, tmp_path):
    asset = read_asset(tree(tmp_path / "a", kind, axis))
    plant = make_plant(asset, free(kind))
    own = plant.gravity_terms
    body = find_correction(plant, nuisance)
    again = write_repaired(asset, (), tmp_path / "b", body=body)
    after = make_plant(again, free(kind))
    assert after.mechanics.inertia == pytest.approx(nuisance.inertia * plant.mechanics.inertia, rel=1e-5)
    true = nuisance.gravity * (own[0] + nuisance.lean[0] * own[1] + nuisance.lean[1] * own[2])
    is_now = after.gravity_terms[0] + sum(np.array([e.cosine, e.sine, e.constant]) for e in body.offset)
    np.testing.assert_allclose(is_now, true, atol=1e-5 * np.abs(own).max())
    assert again.effects.get("j", ()) == body.offset
    root = ET.parse(again.urdf).getroot()
    masses = [float(mass.get("value", 0)) for mass in root.iter("mass")]
    assert masses[0] == 3.0 and masses[1] / masses[2] == pytest.approx(1.5 / 0.4)


def swings(folder: Path, inertia: float, oil: float, count: int = 6) -> tuple[Path, Path]:
    """A pendulum's URDF and its measured set with `inertia` times the URDF's inertia."""
    rng, runs = np.random.default_rng(1), []
    for i in range(count):
        t = np.arange(200) / RATE

        def slope(_, y):
            return [y[1], (-MASS * G * ARM * np.sin(y[0]) - oil * y[1]) / (inertia * INERTIA)]

        start = [(-1) ** i * rng.uniform(0.5, 1.4), 0.0]
        q = solve_ivp(slope, (0, t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.01).y[0]
        runs.append(Run(f"run_{i}", t, q + rng.normal(0, 1e-3, len(t))))
    write_measured(folder / "measured", free("revolute", *runs))
    return asset_of(folder / "asset"), folder / "measured"


def replayed(asset: Path, measured: Path, names: Sequence[str]) -> dict[str, float]:
    """Error (rad) by run of the asset on disk, computed from the files alone."""
    (found,) = replay([AssetOnDisk(asset)], read_measured(measured), names)
    return {run.run: run.error for run in found.runs}


@pytest.mark.parametrize(("inertia", "oil"), [(0.93, 0.0), (1.09, 0.06)])
def test_delivered_files_reproduce_the_verdicts_numbers(inertia: float, oil: float, tmp_path: Path):
    """Also on a run used in no fit, by_run or confirmation."""
    urdf, measured = swings(tmp_path, inertia, oil)
    verdict = gap_folder(urdf, measured, tmp_path / "gap")
    assert [named.effect.name for named in verdict.effects] == (["viscous_damping"] if oil else [])
    given = {c.name: c.value for c in verdict.corrections}
    assert given == {"inertia": pytest.approx(inertia, rel=3e-3)}
    assert f"inertia is {given['inertia']:.4g} times" in verdict.sentence
    by_run = {gap.run: gap for gap in verdict.gaps if gap.use == "confirming"}
    after = replayed(tmp_path / "gap/asset", measured, list(by_run))
    assert after == {name: gap.after for name, gap in by_run.items()}
    assert replayed(urdf, measured, list(by_run)) == {name: gap.before for name, gap in by_run.items()}
    _, mine = swings(tmp_path / "mine", inertia, oil, 7)
    assert replayed(tmp_path / "gap/asset", mine, ["run_6"])["run_6"] < 1.3e-3


def rows(*sizes: tuple[Use, float, float]) -> tuple[RunGap, ...]:
    return tuple(RunGap(f"run_{i}", b, a, 1.0, False, "free", use) for i, (use, b, a) in enumerate(sizes))


@pytest.mark.parametrize(
    ("gaps", "answer"),
    [
        (rows(("fitted", 2.4, 1.0), ("fitted", 1.0, 1.0), ("confirming", 1.1, 1.0)), "no_gap"),
        (rows(("fitted", 9.0, 1.0), ("fitted", 9.0, 1.0), ("confirming", 1.1, 1.0)), "unexplained"),
        (rows(("fitted", 9.0, 1.0), ("fitted", 9.0, 1.0), ("confirming", 9.0, 7.0)), "unexplained"),
        (rows(("fitted", 9.0, 1.0), ("fitted", 9.0, 1.0), ("confirming", 9.0, 2.0)), "named"),
        (rows(("fitted", 9.0, 1.0), ("fitted", 9.0, 1.0)), "named"),
    ],
)
def test_confirmation_runs_decide(gaps: tuple[RunGap, ...], answer: str, tmp_path: Path):
    problem, _ = problem_of(tmp_path, measured_of(0, runs=2))
    oil = NamedEffect(ViscousDamping(0.1), {"coefficient": 0.09}, {"coefficient": 0.11})
    found = _confirm(Verdict("named", (oil,), (), gaps, (), None, "Oil."), problem, JudgementSettings())
    assert (found.verdict, len(found.effects)) == (answer, answer == "named")
    assert (found.next_experiment is not None) == (answer == "unexplained")
