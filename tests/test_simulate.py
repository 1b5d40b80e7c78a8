"""The simulated asset: it keeps its energy, loses what its effects say, and its joint moves as the URDF means."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.urdf import read_urdf_joints
from freeart21.joint import Joint
from generator.simulate import joint_motion, load, roll_out

SHARED = Path(__file__).resolve().parents[2] / "shared"
MASS, ARM = 1.6, 0.5
INERTIA = {"revolute": 0.01 + MASS * ARM**2, "prismatic": MASS}
WEIGHTLESS = (0.0, 0.0, 0.0)
TYPES = pytest.mark.parametrize("kind", ["revolute", "prismatic"])


def write_urdf(
    folder: Path,
    kind: str,
    axis: str = "0 1 0",
    origin: str = "0 0 1",
    limit: str = "",
    inside: str = "",
    more: str = "",
) -> Path:
    """A bob of MASS at ARM below a hinge (or on a slider)."""
    path = folder / "bob.urdf"
    path.write_text(f"""<robot name="bob"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 {-ARM}"/>
        <mass value="{MASS}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="{kind}"><parent link="base"/><child link="bob"/><origin xyz="{origin}" rpy="0 0 0"/>
        <axis xyz="{axis}"/>{limit}{inside}</joint>{more}</robot>""")
    return path


def asset_with(folder: Path, kind: str, *effects, **words) -> Asset:
    return replace(read_asset(write_urdf(folder, kind, **words)), effects={"j": effects})


@TYPES
def test_oscillator_keeps_its_energy_and_period(tmp_path: Path, kind: str):
    stiffness, rest = 30.0, 0.2
    asset = asset_with(tmp_path, kind, ReturnSpring(stiffness, rest))
    run = roll_out(asset, 0.5, 0.3, duration_s=10, gravity=WEIGHTLESS)
    stored = 0.5 * stiffness * (run.q - rest) ** 2
    assert np.ptp(run.energy_j + stored) < 1e-4 * stored.max()
    before = np.flatnonzero(np.diff(np.sign(run.q - rest)))
    crossings = run.times_s[before] + 1e-3 * (run.q - rest)[before] / (run.q[before] - run.q[before + 1])
    period = 2 * (crossings[-1] - crossings[0]) / (len(crossings) - 1)
    assert period == pytest.approx(2 * np.pi * np.sqrt(INERTIA[kind] / stiffness), rel=1e-3)


@TYPES
@pytest.mark.parametrize("level", [0.05, 5.0])
def test_coulomb_friction_decelerates_by_its_level(tmp_path: Path, kind: str, level: float):
    run = roll_out(asset_with(tmp_path, kind, CoulombFriction(level)), 0.0, 3.0, duration_s=2, gravity=WEIGHTLESS)
    deceleration = level / INERTIA[kind]
    expected = np.maximum(3.0 - deceleration * run.times_s, 0.0)
    assert np.abs(run.qd - expected).max() < 0.01 * min(3.0, deceleration * 2)
    if deceleration * 2 > 3:
        assert np.abs(run.qd[-100:]).max() < 1e-6
        assert run.q[-1] == pytest.approx(3.0**2 / (2 * deceleration), rel=0.01)


@TYPES
def test_coulomb_friction_sticks_below_its_level_and_slips_above(tmp_path: Path, kind: str):
    asset = asset_with(tmp_path, kind, CoulombFriction(0.7))
    held = roll_out(asset, 0.4, duration_s=2, gravity=WEIGHTLESS, force=lambda t: 0.95 * 0.7)
    assert np.abs(held.q - 0.4).max() < 1e-5
    slipping = roll_out(asset, 0.4, duration_s=1, gravity=WEIGHTLESS, force=lambda t: 1.05 * 0.7)
    assert slipping.qd[-1] == pytest.approx(0.05 * 0.7 / INERTIA[kind], rel=0.01)


@TYPES
@pytest.mark.parametrize("coefficient", [0.05, 1e4])
@pytest.mark.parametrize("timestep_s", [1e-3, 1e-2])
def test_viscous_damping_decays_exponentially(tmp_path: Path, kind: str, coefficient: float, timestep_s: float):
    asset = asset_with(tmp_path, kind, ViscousDamping(coefficient))
    run = roll_out(asset, 0.0, 3.0, duration_s=1, timestep_s=timestep_s, gravity=WEIGHTLESS)
    rate = coefficient / INERTIA[kind]
    assert run.qd == pytest.approx(3.0 * np.exp(-rate * run.times_s), rel=0.01, abs=1e-6)
    if rate * timestep_s < 0.5:
        assert run.q[-1] == pytest.approx(3.0 / rate * -np.expm1(-rate), rel=0.02)


@TYPES
@pytest.mark.parametrize(
    "dynamics, effects",
    [
        ('<dynamics damping="0.3" friction="0.2"/>', (ViscousDamping(0.3), CoulombFriction(0.2))),
        ('<dynamics damping="0.3"/>', (ViscousDamping(0.3),)),
        ('<dynamics friction="0.2"/>', (CoulombFriction(0.2),)),
    ],
)
def test_urdf_dynamics_means_the_same_effects(tmp_path: Path, kind: str, dynamics: str, effects: tuple):
    asset_of_urdf = read_asset(write_urdf(tmp_path, kind, inside=dynamics))
    assert asset_of_urdf.effects == {"j": effects}
    (tmp_path / "other").mkdir()
    silent = asset_with(tmp_path / "other", kind, *effects)
    runs = [roll_out(asset, 0.1, 2.0, duration_s=2) for asset in (asset_of_urdf, silent)]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    free = roll_out(replace(asset_of_urdf, effects={}), 0.1, 2.0, duration_s=2)
    assert abs(free.q[-1] - runs[0].q[-1]) > 0.01


def test_limits_stop_the_joint_dead(tmp_path: Path):
    asset = asset_with(tmp_path, "revolute", limit='<limit lower="-0.3" upper="1" effort="1" velocity="1"/>')
    run = roll_out(asset, 0.8, duration_s=4)
    assert run.q.min() == pytest.approx(-0.3, abs=1e-6)
    hit = int(np.argmin(run.q))
    assert run.q[hit:].max() == pytest.approx(0.3, abs=1e-3)
    with pytest.raises(FreeArtError, match=r"starts at 2, expected within its limits -0.3 to 1"):
        roll_out(asset, 2.0, duration_s=1)


def test_same_call_same_bits(tmp_path: Path):
    asset = asset_with(tmp_path, "revolute", ViscousDamping(0.1), CoulombFriction(0.05), ReturnSpring(2.0, 0.1))
    simulated = load(asset)
    runs = [roll_out(a, 0.7, -1.0, duration_s=1) for a in (asset, simulated, simulated)]
    for run in runs[1:]:
        np.testing.assert_array_equal(runs[0].q, run.q)
        np.testing.assert_array_equal(runs[0].qd, run.qd)


def random_pose(rng: np.random.Generator, shift: float = 0.5) -> np.ndarray:
    return se3.exp_se3(np.concatenate([rng.uniform(-shift, shift, 3), rng.normal(size=3)]))


@TYPES
@pytest.mark.parametrize("reference_hangs", [False, True])
def test_joint_motion_is_the_joint_in_any_canonical_frame(tmp_path: Path, kind: str, reference_hangs: bool):
    rng = np.random.default_rng(3)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    origin = rng.uniform(-0.3, 0.3, 3)
    asset = asset_with(
        tmp_path,
        kind,
        axis=" ".join(map(str, axis)),
        origin=" ".join(map(str, origin)),
        limit='<limit lower="0.1" upper="0.6" effort="1" velocity="1"/>',
    )
    C, zero = random_pose(rng), 0.25
    links = (asset.moving_link, asset.reference_link) if reference_hangs else (asset.reference_link, asset.moving_link)
    asset = replace(asset, T_canonical_reference=C, state_zero=zero, reference_link=links[0], moving_link=links[1])
    states = np.array([0.0, 0.2, -0.7, 2.5])  # the last two beyond the limits
    expected = Joint("j", kind, axis, origin, -9, 9)
    if reference_hangs:  # the base turns the other way, against a frame whose origin is on the axis
        expected = Joint("j", kind, -axis, [0, 0, 0], -9, 9)
    np.testing.assert_allclose(joint_motion(asset, states), expected.moved(C).transform(states), atol=1e-6)


def test_other_joints_are_held_where_the_asset_says(tmp_path: Path):
    more = """<link name="tip"/><joint name="k" type="revolute"><parent link="bob"/><child link="tip"/>
        <axis xyz="1 0 0"/><limit lower="0.2" upper="1"/><origin xyz="0.1 0 0"/></joint>"""
    asset = replace(read_asset(write_urdf(tmp_path, "prismatic", more=more), "j"), moving_link="tip")
    assert asset.held == {"k": 0.2}
    for held in (0.2, 0.7):
        simulated = load(replace(asset, held={"k": held}))
        assert simulated.articulation.dof == 1
        simulated.set_state(0.3)
        hung = se3.pose(se3.exp_so3([held, 0, 0]), [0.1, 0.3, 1])
        np.testing.assert_allclose(simulated.T_reference_moving(), hung, atol=1e-6)


def test_faults_cost_one_clear_line(tmp_path: Path):
    mesh = """<link name="x"><visual><geometry><mesh filename="no.obj"/></geometry></visual></link>
        <joint name="f" type="fixed"><parent link="bob"/><child link="x"/></joint>"""
    loose = '<link name="x"/>'
    floating = '<link name="x"/><joint name="f" type="floating"><parent link="bob"/><child link="x"/></joint>'
    twice = '<link name="bob"/>'
    for more, message in (
        (mesh, "mesh 'no.obj', which does not exist"),
        (loose, "has the root links base, x, expected one"),
        (floating, "type 'floating'"),
        (twice, "link 'bob' 2 times"),
    ):
        asset = read_asset(write_urdf(tmp_path, "revolute", more=more))
        with pytest.raises(FreeArtError, match=message) as caught:
            load(asset)
        assert "\n" not in str(caught.value)
    good = asset_with(tmp_path, "revolute")
    for wrong, message in (
        (replace(good, moving_link="lid"), "no link 'lid'; links: base, bob"),
        (replace(good, joint="lid"), "no movable joint 'lid'; movable joints: j"),
        (replace(good, moving_link="base"), "on the same side"),
    ):
        with pytest.raises(FreeArtError, match=message):
            load(wrong)
    with pytest.raises(FreeArtError, match="no link 'lid'; links: base, bob"):
        load(good).link_pose("lid")
    with pytest.raises(FreeArtError, match="without a scene"):
        load(good, visuals=True)
    massless = tmp_path / "massless.urdf"
    massless.write_text("""<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">
        <parent link="a"/><child link="b"/></joint></robot>""")
    with pytest.raises(FreeArtError, match="moves nothing of mass"):
        roll_out(read_asset(massless), 0, duration_s=1)
    with pytest.raises(FreeArtError, match="internal steps"):
        load(asset_with(tmp_path, "prismatic", ReturnSpring(1e6, 0)), timestep_s=1.0)


@pytest.mark.skipif(not (SHARED / "partnet_mobility").is_dir(), reason="no PartNet-Mobility objects")
@pytest.mark.parametrize("number", ["40147", "41083"])
def test_partnet_objects_load_and_move_freely(number: str):
    urdf = SHARED / "partnet_mobility" / number / "mobility.urdf"
    for joint in read_urdf_joints(urdf).values():
        if joint.joint_type is None:
            continue
        asset = read_asset(urdf, joint.name)
        simulated = load(asset, gravity=WEIGHTLESS, timestep_s=0.01)
        middle, speed = 0.5 * (joint.lower + joint.upper), 0.2 * (joint.upper - joint.lower)
        run = roll_out(simulated, middle, speed, duration_s=2)
        assert run.q == pytest.approx(middle + speed * run.times_s, abs=1e-5)
        simulated.set_state(0.0)
        in_reference = simulated.world_joint.moved(se3.inverse(simulated.link_pose(asset.reference_link)))
        states = np.array([joint.lower, joint.upper, joint.upper + 0.5])
        np.testing.assert_allclose(joint_motion(asset, states), in_reference.transform(states), atol=2e-6)
