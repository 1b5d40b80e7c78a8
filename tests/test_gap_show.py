"""Effects written into an asset, its gap in a separate SAPIEN process, and the loop on our own data."""

from __future__ import annotations

import json
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_case import replay_both
from scipy.integrate import solve_ivp

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.armature import Armature
from freeart21.effects.axis_tilt import AxisTilt
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.detent import Detent
from freeart21.effects.pivot_offset import PivotOffset
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset, write_asset_json
from freeart21.measured import Measured, Run
from generator.simulate import joint_motion, roll_out
from simgap.geometry.kinematics import find_geometry
from simgap.geometry.placing import place
from simgap.models.equation_error import estimate_missing_force
from simgap.models.localise import make_residual_maps
from simgap.page.publish import Draft, publish, replace_poses
from simgap.page.report import Ranked
from simgap.prove.comparison import closed_part, is_improved
from simgap.prove.writeback import write_repaired
from simgap.verdict import GEOMETRY, NamedEffect, RunGap, Verdict

MASS, ARM, G = 1.2, 0.3, 9.81
INERTIA = 0.01 + MASS * ARM**2


def bob(folder: Path, more: str = "", limits: str = '<limit lower="-3" upper="3"/>') -> Asset:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "bob.urdf"
    path.write_text(f"""<?xml version="1.0"?><robot name="bob"><!-- by hand --><link name="base"/><link name="bob">
        <inertial><origin xyz="0 0 {-ARM}"/><mass value="{MASS}"/>
        <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="revolute"><parent link="base"/><child link="bob"/><origin xyz="0 0 1" rpy="0 0 0"/>
        <axis xyz="0 1 0"/>{limits}{more}</joint></robot>""")
    return read_asset(path)


def pendulum(starts, torque, seconds=3.0, inertia=INERTIA, gravity=1.0, seed=0, noise=1e-3, **channels):
    """A measured set and its true initial states, by an independent equation."""
    rng = np.random.default_rng(seed)
    runs = []
    for i, (q0, qd0) in enumerate(starts):
        t = np.sort(np.arange(round(150 * seconds)) / 150 + rng.uniform(-1, 1, round(150 * seconds)) * 1e-3)
        t = t - t[0] + 0.2 * i  # clocks need not begin at zero

        def slope(s, y):
            return [y[1], (torque(s, *y) - gravity * MASS * G * ARM * np.sin(y[0])) / inertia]

        done = solve_ivp(slope, (t[0], t[-1]), [q0, qd0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.01)
        given = {name: np.array([f(s) for s in t]) for name, f in channels.items() if callable(f)}
        runs.append(Run(f"run_{i}", t, done.y[0] + rng.normal(size=len(t)) * noise, **given))
    return Measured("j", "revolute", np.array([0, 0, -G]), 150.0, "recorded", runs=tuple(runs))


STARTS = ((1.2, 0.0), (0.4, 0.5), (-1.5, 0.0))


def damped(s, q, qd):
    return -0.03 * qd


# ---------------------------------------------------------------- into the asset


def test_urdf_has_its_share_and_effects_json_has_all(tmp_path: Path):
    asset = bob(tmp_path / "a", '<dynamics damping="0.01"/>')
    new = (ViscousDamping(0.02), CoulombFriction(0.05), Detent(0.3, 0.2, 0.05), AxisTilt(0.01, 0.0))
    again = write_repaired(asset, new, tmp_path / "b", {"by": "test"})
    assert again.effects == {"j": (ViscousDamping(0.03), *new[1:])}
    text = again.urdf.read_text()
    assert "<!-- by hand -->" in text
    dynamics = ET.fromstring(text).find("joint/dynamics")
    assert dynamics is not None
    assert (float(dynamics.get("damping", 0)), float(dynamics.get("friction", 0))) == pytest.approx((0.03, 0.05))
    assert again.source["repair"] == {"by": "test"}
    assert asset.effects == {"j": (ViscousDamping(0.01),)} == read_asset(asset.urdf).effects  # untouched
    run = roll_out(again, 1.0, duration_s=0.5)
    rolled = roll_out(replace(asset, effects={"j": again.effects["j"]}), 1.0, duration_s=0.5)
    np.testing.assert_array_equal(run.q, rolled.q)


def test_mjcf_next_to_the_urdf_is_updated(tmp_path: Path):
    mujoco = pytest.importorskip("mujoco")
    asset = bob(tmp_path / "a")
    (tmp_path / "a/bob.xml").write_text("""<mujoco><worldbody><body name="base"><body name="bob" pos="0 0 1">
        <joint name="j" type="hinge" axis="0 1 0" frictionloss="9"/><inertial pos="0 0 -0.3" mass="1.2"
        diaginertia="0.01 0.01 0.01"/></body></body></worldbody></mujoco>""")
    write_asset_json(tmp_path / "a", asset)
    again = write_repaired(read_asset(tmp_path / "a"), (ViscousDamping(0.02), Armature(0.003)), tmp_path / "b")
    joint = mujoco.MjModel.from_xml_path(str(again.urdf.with_suffix(".xml")))
    assert joint.dof_damping[0] == pytest.approx(0.02)
    assert joint.dof_armature[0] == pytest.approx(0.003)
    assert joint.dof_frictionloss[0] == 0


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_an_equivalent_mjcf_is_written(tmp_path: Path, kind: str):
    """Rotated origins, a fixed joint between, a rotated inertia, shapes: MuJoCo and SAPIEN agree."""
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "a").mkdir()
    (tmp_path / "a/tree.urdf").write_text(f"""<robot name="tree"><link name="root"><collision><geometry>
        <box size="0.2 0.2 0.2"/></geometry></collision></link><link name="middle"/><link name="bob"><inertial>
        <origin xyz="0.1 0.05 -0.3" rpy="0.3 0.2 0.1"/><mass value="1.5"/>
        <inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="0.001" ixz="0" iyz="0.002"/></inertial>
        <visual><origin xyz="0 0 -0.3"/><geometry><sphere radius="0.05"/></geometry></visual>
        <collision><geometry><cylinder radius="0.02" length="0.3"/></geometry></collision></link>
        <joint name="held" type="revolute"><parent link="root"/><child link="middle"/>
        <origin xyz="0 0 1" rpy="0.2 0 0.4"/><axis xyz="1 0 0"/><limit lower="0.1" upper="1"/></joint>
        <joint name="j" type="{kind}"><parent link="middle"/><child link="bob"/><origin xyz="0.1 0 0.1" rpy="0 0.3 0"/>
        <axis xyz="0.2 2 0.4"/><limit lower="-9" upper="9"/></joint></robot>""")
    effects = (ViscousDamping(0.4), ReturnSpring(6.0, 0.1), Armature(0.02))
    again = write_repaired(read_asset(tmp_path / "a/tree.urdf", "j"), effects, tmp_path / "b")
    model = mujoco.MjModel.from_xml_path(str(again.urdf.with_suffix(".xml")))
    model.opt.timestep = 5e-4
    data = mujoco.MjData(model)
    data.qpos[0] = 0.5
    theirs = [0.5]
    for _ in range(2000):
        mujoco.mj_step(model, data)
        theirs.append(float(data.qpos[0]))
    run = roll_out(again, 0.5, duration_s=1.0)
    assert np.abs(run.q - theirs[::2]).max() < 2e-3
    assert np.ptp(run.q) > 0.1


@pytest.mark.parametrize("named_as", ["{out}/box.obj", "package://robot/shapes/box.obj", "../robot/shapes/box.obj"])
def test_external_meshes_are_copied(tmp_path: Path, named_as: str):
    """Absolute, package:// and parent paths: the copy is self-contained and nothing is written outside it."""
    mujoco = pytest.importorskip("mujoco")
    out = tmp_path / "robot/shapes"
    out.mkdir(parents=True)
    (tmp_path / "robot/secret.png").write_bytes(b"png")
    (out / "box.png").write_bytes(b"png")
    (out / "box.mtl").write_text("newmtl m\nmap_Kd box.png\nmap_Bump ../secret.png\n")
    cube = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    (out / "box.obj").write_text(f"mtllib box.mtl\n{cube}f 1 2 3\nf 1 2 5\nf 1 3 5\nf 2 3 5\nf 8 7 6\n")
    asset = bob(tmp_path / "a")
    visual = f'<visual><geometry><mesh filename="{named_as.format(out=out)}"/></geometry></visual>'
    asset.urdf.write_text(asset.urdf.read_text().replace("</inertial>", f"</inertial>{visual}"))
    with pytest.raises(FreeArtError, match=r"leads out of the folder|does not exist: looked for .* --root DIR"):
        write_repaired(read_asset(asset.urdf), (ViscousDamping(0.02),), tmp_path / "b/c")
    again = write_repaired(read_asset(asset.urdf, root=tmp_path), (ViscousDamping(0.02),), tmp_path / "b/c")
    files = {str(p.relative_to(tmp_path / "b")) for p in (tmp_path / "b").rglob("*") if p.is_file()}
    meshes = {f"c/outside/0/box.{ending}" for ending in ("obj", "mtl", "png")}
    assert files == {"c/bob.urdf", "c/bob.xml", "c/asset.json", "c/effects.json", *meshes}
    shutil.rmtree(tmp_path / "robot")
    assert again.urdf.read_text().count('filename="outside/0/box.obj"') == 1
    mujoco.MjModel.from_xml_path(str(again.urdf.with_suffix(".xml")))
    twice = write_repaired(again, (CoulombFriction(0.02),), tmp_path / "d")  # and may be repaired again
    assert (tmp_path / "d/outside/0/box.png").is_file() and len(twice.effects["j"]) == 2


@pytest.mark.parametrize(
    ("name", "message"),
    [("/etc/hostname", "leads out"), ("notes.txt", "expected a mesh or a picture"), ("big.obj", "at most")],
)
def test_unsafe_urdf_references_are_not_copied(tmp_path: Path, name: str, message: str, monkeypatch):
    asset = bob(tmp_path / "a")
    monkeypatch.setattr("freeart21.files.asset_copy.MAX_BYTES", 1000)
    (tmp_path / "a/big.obj").write_bytes(b"#" * 1001)
    (tmp_path / "a/notes.txt").write_text("")
    visual = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    asset.urdf.write_text(asset.urdf.read_text().replace("</inertial>", f"</inertial>{visual}"))
    with pytest.raises(FreeArtError, match=message) as caught:
        write_repaired(read_asset(asset.urdf), (), tmp_path / "b")
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- and shown


def test_a_correct_repair_closes_the_gap_in_replay(tmp_path: Path):
    asset, measured = bob(tmp_path / "a"), pendulum(STARTS, damped)
    again = write_repaired(asset, (ViscousDamping(0.03),), tmp_path / "b")
    there = replay_both(asset, again, measured, STARTS, regimes=["fast", "slow", "fast"])
    for run in there.runs:
        assert run.before > 30 * run.floor
        assert run.after < 1.5 * run.floor
        assert run.curves[1] == pytest.approx(run.measured, abs=8e-3)
    assert is_improved(there.runs) and there.numerics < 0.1
    near, far = there.split({"slow"})
    assert [run.run for run in near] == ["run_1"] and [run.run for run in far] == ["run_0", "run_2"]
    assert (closed_part(there.runs) or 0.0) > 0.97 and closed_part([]) is None


def test_a_wrong_repair_is_no_improvement(tmp_path: Path):
    asset, measured = bob(tmp_path / "a"), pendulum(STARTS[:2], damped)
    again = write_repaired(asset, (ReturnSpring(1.0, 0.0),), tmp_path / "b")
    assert not is_improved(replay_both(asset, again, measured, STARTS[:2]).runs)
    good = replay_both(asset, write_repaired(asset, (ViscousDamping(0.03),), tmp_path / "c"), measured, STARTS[:2])
    first, second = good.runs
    quick = replace(first, before=20 * first.floor, after=first.floor)
    for wider, fine in ((0.2, True), (0.3, False)):  # nor one that harms another regime by a quarter floor
        slow = replace(second, before=10 * second.floor, after=(10 + wider) * second.floor, regime="slow")
        assert is_improved(good.runs) and is_improved((quick, slow)) == fine


# ---------------------------------------------------------------- and published


def named(*effects):
    ends = [{n: getattr(e, n) for n in e.parameters()} for e in effects]
    return tuple(NamedEffect(e, end, end) for e, end in zip(effects, ends, strict=True))


def use_of(run):
    return "confirming" if run.held_out else "fitted"


def draft(measured, starts, *effects, answer="named", **more):
    gaps = tuple(
        RunGap(run.name, 0.1, np.nan, 1e-3, bool(run.held_out), "fast" if abs(s[0]) > 0.5 else "slow", use_of(run))
        for run, s in zip(measured.runs, starts, strict=True)
    )
    verdict = Verdict(answer, named(*effects), (), gaps, (), None, "Oil is missing.")
    return Draft(
        verdict,
        ranking=(Ranked(tuple(e.name for e in effects), 1.1), Ranked((), 90.0, -500.0, 20.0)),
        floor=1e-3,
        certain=verdict.effects if answer == "named" else (),
        **more,
    )


def held_out(measured, *which):
    return replace(measured, runs=tuple(replace(r, held_out=i in which) for i, r in enumerate(measured.runs)))


def test_a_verdict_is_published_with_sapiens_gaps(tmp_path: Path):
    asset, measured = bob(tmp_path / "a"), held_out(pendulum(STARTS, damped), 1, 2)
    out = tmp_path / "out"
    out.mkdir()
    verdict = publish(asset, measured, draft(measured, STARTS, ViscousDamping(0.03)), out, "A <bob>", 1.0)
    assert verdict.verdict == "named" and verdict.where
    rms_by_run = {gap.run: gap for gap in verdict.gaps}
    assert np.isnan(rms_by_run["run_0"].before) and np.isnan(rms_by_run["run_0"].after)  # fitted, not replayed
    data = json.loads((out / "verdict.json").read_text())
    assert [gap["run"] for gap in data["gap"]] == ["run_1", "run_2"] and data["uses"]["run_0"] == "fitted"
    for name in ("run_1", "run_2"):
        assert rms_by_run[name].before > 20e-3 and rms_by_run[name].after < 1.5e-3
    assert read_asset(out / "asset").effects == {"j": (ViscousDamping(0.03),)}
    page = (out / "index.html").read_text()
    assert "A &lt;bob&gt;" in page and "<bob>" not in page
    for text in (
        "Oil is missing.",
        "Viscous damping",
        "3 runs: 1 fitted, 2 confirming",
        "Run run_1, confirming, slow",
    ):
        assert text in page, text
    assert "http://" not in page.replace("http://www.w3.org", "") and "src=" not in page


def test_a_useless_repair_is_rolled_back(tmp_path: Path):
    asset, measured = bob(tmp_path / "a", '<dynamics damping="0.01"/>'), held_out(pendulum(STARTS, damped), 1)
    out = tmp_path / "out"
    out.mkdir()
    verdict = publish(asset, measured, draft(measured, STARTS, ReturnSpring(1.0, 0.0)), out, "bob")
    assert (verdict.verdict, verdict.effects) == ("unexplained", ())
    (gap,) = [gap for gap in verdict.gaps if np.isfinite(gap.before)]
    assert gap.after == gap.before != gap.trial
    assert read_asset(out / "asset").effects == {"j": (ViscousDamping(0.01),)}
    assert len(read_asset(out / "trial").effects["j"]) == 2
    page = (out / "index.html").read_text()
    assert "rolled back: replayed in SAPIEN it did not help on 1 run kept to confirm it, or" in page


def filmed(asset: Asset, seed: int = 0, runs: int = 4, fps: float = 30.0, gravity: tuple[float, ...] = (0, 0, -G)):
    """Our own loop: a joint released in SAPIEN, tracked with errors correlated between frames."""
    rng, made, true = np.random.default_rng(seed), [], []
    for r in range(runs):
        rolled = roll_out(asset, rng.uniform(0.8, 1.4), 0.0, duration_s=4.0, timestep_s=1 / 300, gravity=gravity)
        q, t = rolled.q[::10], rolled.times_s[::10]
        error = np.zeros((len(t), 6))
        for i in range(len(t)):
            error[i] = 0.8 * error[i - 1] + 0.6 * rng.normal(size=6) * 1e-3
        centre = se3.pose(np.eye(3), [0, 0, 1 - ARM])
        shaken = centre @ se3.exp_se3(error) @ se3.inverse(centre)
        poses = joint_motion(asset, q, t, gravity) @ shaken
        made.append(
            Run(f"take_{r}", t, np.full(len(t), np.nan), None, None, poses, np.ones(len(t), bool), r == runs - 1)
        )
        true.append((q, (float(rolled.q[0]), 0.0)))
    return Measured("j", "revolute", np.array(gravity, float), fps, "recorded", runs=tuple(made)), true


def test_a_filmed_release_is_explained_from_part_poses(tmp_path: Path):
    """Geometry and dynamics in one film: a tilted axis and damping are separated, written and replayed in SAPIEN."""
    asset = bob(tmp_path / "a")
    crooked = (AxisTilt(0.02, -0.015), PivotOffset(0.01, 0.006))
    measured, true = filmed(replace(asset, effects={"j": (*crooked, ViscousDamping(0.03))}))
    geometry = find_geometry(asset, measured)
    assert geometry is not None and geometry.verdict == "named"
    assert {e.name for e in geometry.effects} == {"axis_tilt", "pivot_offset"}
    runs = replace_poses(measured, geometry)
    for run, (q, _) in zip(runs.runs, true, strict=True):
        assert np.sqrt(np.mean((run.q - q) ** 2)) < 2e-3
    lacking = estimate_missing_force(runs, place(asset, runs.gravity).mechanics, -3.0, 3.0)
    direction = next(m for m in make_residual_maps(lacking, 0) if m.quantity == "velocity")
    assert direction.adjusted < 0.05 and direction.mean[1] > 0 > direction.mean[-2]  # a brake
    starts = tuple(start for _, start in true)
    out = tmp_path / "out"
    out.mkdir()
    draft_verdict = draft(measured, starts, *geometry.effects, ViscousDamping(0.03), geometry=geometry)
    verdict = publish(asset, measured, draft_verdict, out, "our own film")
    assert verdict.verdict == "named"
    gaps = {(gap.run, gap.regime): gap for gap in verdict.gaps if gap.held_out}
    off_joint, motion = gaps["take_3", GEOMETRY], gaps["take_3", "fast"]
    assert off_joint.before > 4 * off_joint.floor and off_joint.after < 1.3 * off_joint.floor
    assert motion.before > 20e-3 and motion.after < 3e-3
    assert "Off its joint: Run take_3" in (out / "index.html").read_text()
