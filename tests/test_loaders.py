"""An asset's own loaders: in every engine the released joint follows the equation of its damping and friction."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from engine_case import EFFECTS, GRAVITY, loader, release_of, write_case

from freeart21.effects.armature import Armature
from freeart21.effects.latch import Latch
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from generator.simulate import roll_out

KINDS = ("revolute", "prismatic")
DURATION = {"revolute": 3.0, "prismatic": 1.2}
STEP = 1e-3


class InSapien:
    def __init__(self, folder: Path, fixed: bool | None = True, gravity: float = GRAVITY):
        import sapien

        before = sapien.physx.get_scene_config().gravity
        sapien.physx.set_scene_config(gravity=np.array([0, 0, -gravity], np.float32))
        self.scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        sapien.physx.set_scene_config(gravity=before)
        self.scene.set_timestep(STEP)
        self.body = loader(folder, "sapien").load(self.scene, fixed=fixed)

    def put(self, q: float, qd: float = 0.0) -> None:
        self.body.set_qpos([q])
        self.body.set_qvel([qd])

    def step(self) -> None:
        self.scene.step()

    def q(self) -> float:
        return float(self.body.qpos[0])

    def height(self) -> float:
        return float(self.body.root_pose.p[2])


class InMujoco:
    def __init__(self, folder: Path, fixed: bool | None = True, gravity: float = GRAVITY):
        import mujoco

        spec = loader(folder, "mujoco").load(fixed=fixed)
        spec.option.timestep = STEP
        spec.option.gravity = [0, 0, -gravity]
        self.mujoco, self.model = mujoco, spec.compile()
        self.data = mujoco.MjData(self.model)
        self.joint = self.data.joint("hinge")

    def put(self, q: float, qd: float = 0.0) -> None:
        self.joint.qpos[0], self.joint.qvel[0] = q, qd

    def step(self) -> None:
        self.mujoco.mj_step(self.model, self.data)

    def q(self) -> float:
        return float(self.joint.qpos[0])

    def height(self) -> float:
        return float(self.data.body("reference").xpos[2])


class InPybullet:
    def __init__(self, folder: Path, fixed: bool | None = True, gravity: float = GRAVITY):
        import pybullet

        pybullet.resetSimulation() if pybullet.isConnected() else pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -gravity)
        pybullet.setTimeStep(STEP)
        self.engine, self.body = pybullet, loader(folder, "pybullet").load(fixed=fixed)
        names = [pybullet.getJointInfo(self.body, i)[1] for i in range(pybullet.getNumJoints(self.body))]
        self.joint = names.index(b"hinge")

    def put(self, q: float, qd: float = 0.0) -> None:
        self.engine.resetJointState(self.body, self.joint, q, qd)

    def step(self) -> None:
        self.engine.stepSimulation()

    def q(self) -> float:
        return float(self.engine.getJointState(self.body, self.joint)[0])

    def height(self) -> float:
        return float(self.engine.getBasePositionAndOrientation(self.body)[0][2])


class InDrake:
    def __init__(self, folder: Path, fixed: bool | None = True, gravity: float = GRAVITY):
        from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
        from pydrake.systems.analysis import Simulator
        from pydrake.systems.framework import DiagramBuilder

        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, STEP)
        plant.mutable_gravity_field().set_gravity_vector([0, 0, -gravity])
        module = loader(folder, "drake")
        instance = module.load(plant, fixed=fixed)
        plant.Finalize()
        module.connect(builder, plant, instance)
        self.simulator = Simulator(builder.Build())
        self.context = plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        self.plant, self.joint, self.steps = plant, plant.GetJointByName("hinge", instance), 0

    def put(self, q: float, qd: float = 0.0) -> None:
        angle = self.joint.type_name() == "revolute"
        (self.joint.set_angle if angle else self.joint.set_translation)(self.context, q)
        (self.joint.set_angular_rate if angle else self.joint.set_translation_rate)(self.context, qd)

    def step(self) -> None:
        self.steps += 1
        self.simulator.AdvanceTo(self.steps * STEP)

    def q(self) -> float:
        return float(self.joint.GetOnePosition(self.context))

    def height(self) -> float:
        return float(
            self.plant.EvalBodyPoseInWorld(self.context, self.plant.GetBodyByName("reference")).translation()[2]
        )


ENGINES = {"sapien": InSapien, "mujoco": InMujoco, "pybullet": InPybullet, "drake": InDrake}
MODULES = {"drake": "pydrake"}


@pytest.fixture(params=ENGINES)
def engine(request) -> type:
    pytest.importorskip(MODULES.get(request.param, request.param))
    return ENGINES[request.param]


def course(simulated, q0: float, duration_s: float, qd0: float = 0.0) -> np.ndarray:
    simulated.put(q0, qd0)
    seen = [q0]
    for _ in range(round(duration_s / STEP)):
        simulated.step()
        seen.append(simulated.q())
    return np.array(seen)


@pytest.mark.parametrize("kind", KINDS)
def test_the_released_joint_follows_its_equation(tmp_path: Path, engine: type, kind):
    release = release_of(kind)
    write_case(tmp_path, kind)
    seen = course(engine(tmp_path), release.q0, DURATION[kind])
    expected = release.course(np.arange(len(seen)) * STEP)
    off = np.abs(seen - expected).max() / np.ptp(expected)
    print(f"{engine.__name__} {kind}: {off:.3%} of the amplitude")
    assert off < 0.01
    without = type(release)(release.q0, release.inertia, release.gravity, release.damping, 0.0)
    assert np.abs(seen - without.course(np.arange(len(seen)) * STEP)).max() / np.ptp(expected) > 0.03


@pytest.mark.parametrize("kind", KINDS)
def test_springs_and_armature_act_where_a_loader_says_so(tmp_path: Path, engine: type, kind):
    effects = (*EFFECTS[kind], ReturnSpring(0.5 if kind == "revolute" else 4.0, 0.3), Armature(0.002))
    asset = write_case(tmp_path, kind, effects)
    name = engine.__name__.removeprefix("In").lower()
    left = {e.joint_word for e in effects} - loader(tmp_path, name).PLAYED
    if left:
        with pytest.warns(UserWarning, match="without armature, return_spring"):
            engine(tmp_path)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        seen = course(engine(tmp_path), -0.8, 1.0)
    expected = roll_out(asset, -0.8, duration_s=1.0, timestep_s=STEP).q
    assert np.abs(seen - expected).max() / np.ptp(expected) < 0.01


def test_a_free_asset_falls_and_a_fixed_one_stays(tmp_path: Path, engine: type):
    write_case(tmp_path / "free", "revolute")
    write_case(tmp_path / "fixed", "revolute", base="fixed")
    for name, fixed, falls in (("free", None, True), ("free", True, False), ("fixed", None, False)):
        simulated = engine(tmp_path / name, fixed)
        before = simulated.height() if simulated.step() is None else 0.0
        course(simulated, 0.0, 0.2)
        drop = before - simulated.height()
        expected = 0.5 * GRAVITY * 0.2**2
        assert (abs(drop - expected) < 0.1 * expected) if falls else abs(drop) < 1e-9, (name, fixed, drop)
    with pytest.raises(ValueError, match="exported with a fixed base"):
        engine(tmp_path / "fixed", False)


def test_effects_that_an_engine_lacks_are_named(tmp_path: Path, engine: type):
    write_case(tmp_path, "revolute", (ViscousDamping(0.01), Latch(0.2, 0.1, 0.05, 0.5)))
    with pytest.warns(UserWarning, match="without latch"):
        engine(tmp_path)


def test_parts_that_overlap_do_not_push_each_other(tmp_path: Path, engine: type):
    for kind in KINDS:
        write_case(tmp_path / kind, kind, (ViscousDamping(0.01),), pivot=np.array([0.02, 0.0, 0.05]))
        seen = course(engine(tmp_path / kind, gravity=0.0), 0.0, 0.3)
        assert np.abs(seen).max() < 1e-6


def test_speed_is_limited_where_an_engine_can(tmp_path: Path, engine: type):
    write_case(tmp_path, "prismatic", (ViscousDamping(0.001),), velocity=1.0)
    seen = course(engine(tmp_path), -2.0, 0.4)
    speed = (seen[-1] - seen[-2]) / STEP
    restored = engine is not InMujoco and engine is not InDrake
    assert speed == pytest.approx(1.0 if restored else 0.8 * GRAVITY * 0.4, rel=0.01)
