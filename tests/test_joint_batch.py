"""Effects in torch, for many environments at once, against numpy's laws and against SAPIEN's steps, one at a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusal import assert_refused
from test_surrogate import FREE, asset_at

from freeart21.effects import EFFECTS
from freeart21.effects.base import Effect
from freeart21.mechanics import Actuator
from generator.simulate import load

torch = pytest.importorskip("torch", reason="torch is not installed: freeart21[torch]")
from export.maniskill._batch import JointBatch, torch_law  # noqa: E402  it imports torch

SIZES = pytest.mark.parametrize("n", [1, 64])
LAWFUL = [name for name, cls in EFFECTS.items() if cls.acts in ("force", "drive", "stop")]
DYNAMIC = (
    *FREE.values(),
    EFFECTS["end_stop_bounce"](0.5, 0.1),
    EFFECTS["armature"](0.2, 0.6, 0.01),
    EFFECTS["backlash"](0.05, 0.1, 0.3),
    EFFECTS["actuator_gain"](0.8),
    EFFECTS["actuator_offset"](-0.2),
    EFFECTS["actuator_delay"](0.012),
)


@SIZES
@pytest.mark.parametrize("name", LAWFUL)
def test_a_law_in_torch_is_numpys(name, n):
    rng, cls = np.random.default_rng(n), EFFECTS[name]
    q, qd, load_n, memory = rng.uniform(-1, 1, (4, n))
    values = rng.uniform(0.1, 0.9, (len(cls.parameters()), n))
    for law in [cls.law] + ([cls.remember] if cls.remember is not Effect.remember else []):
        of_state = (q, memory) if law is cls.remember else (q, qd, np.abs(load_n), memory)
        true = law(*of_state, *values)
        made = torch_law(law)(*map(torch.from_numpy, (*of_state, *values)))
        np.testing.assert_allclose(made.numpy(), true, rtol=1e-12, atol=1e-12)


def draw(rng: np.random.Generator, folder: Path, effects: tuple[Effect, ...] | None = None):
    """A simulated joint of either type about any axis, with limits within reach and up to three effects."""
    kind = rng.choice(["revolute", "prismatic"])
    axis = " ".join(f"{x:.3f}" for x in rng.normal(size=3))
    if effects is None:
        chosen = [DYNAMIC[i] for i in rng.choice(len(DYNAMIC), rng.integers(0, 4), replace=False)]
        effects = tuple(e for e in chosen if kind in e.joint_types and e.kind == "dynamics")
    return load(asset_at(folder, str(kind), *effects, axis=axis, lower=-0.4, upper=0.5))


def step(batch: JointBatch) -> None:
    """Advance by its step joints that nothing touches."""
    h = batch.timestep_s / batch.substeps
    for _ in range(batch.substeps):
        kick = batch.before_engine(h)
        inertia = batch.joint_inertia + kick.armature
        free = batch.qd + h * (batch.gravity_force(kick.q) + kick.force) / inertia
        batch.after_engine(torch.sign(free) * (free.abs() - h * kick.friction / inertia).clamp(min=0.0), h)


@SIZES
@pytest.mark.parametrize("motors", [False, True])
def test_a_batch_of_joints_moves_as_each_alone_in_sapien(tmp_path, n, motors):
    """Random states, axes, types and effects, impacts at limits among them, 0.15 s at 1 kHz; commands change."""
    rng = np.random.default_rng(7 + n)
    joints = [draw(rng, tmp_path) for _ in range(n)]
    q, qd = rng.uniform(-0.4, 0.5, n), rng.uniform(-12, 12, n)
    commands = rng.uniform(-0.4, 0.5, (3, n))
    batch = JointBatch(joints)
    batch.set_state(torch.from_numpy(q), torch.from_numpy(qd))
    for joint, *state in zip(joints, q, qd, strict=True):
        joint.set_state(*state)
    inertia = np.array([joint.joint_inertia for joint in joints])
    stiffness, damping = 400 * inertia, 30 * inertia
    if motors:
        batch.set_motor(torch.from_numpy(stiffness), torch.from_numpy(damping))
        for i, joint in enumerate(joints):

            def commanded(t, i=i):
                k = int(np.floor(t / 0.05 + 1e-9)) if t >= 0 else -1
                return commands[min(k, 2), i] if k >= 0 else q[i]

            def weight(t, joint=joint):
                return -float(joint.mechanics.gravity_force(joint.state()[0]))

            joint.set_actuator(Actuator(commanded, stiffness[i], damping[i], weight))
    off, met = np.zeros(n), np.zeros(n, bool)
    for k in range(150):
        if motors and k % 50 == 0:
            batch.command(torch.from_numpy(commands[k // 50]))
        step(batch)
        for joint in joints:
            joint.step()
        true = np.array([joint.state()[0] for joint in joints])
        off = np.maximum(off, np.abs(batch.q.numpy() - true))
        met |= np.array([joint._impact_velocity != 0 for joint in joints])
    assert n == 1 or (np.median(np.abs(true - q)) > 0.01 and met.sum() > 2)
    worst = int(off.argmax())
    assert off.max() < 1e-4, (joints[worst].world_joint.type, joints[worst].effects, q[worst], qd[worst])
    assert np.median(off) < 1e-6


def test_what_one_environment_begins_anew_leaves_the_others(tmp_path):
    latch = (EFFECTS["latch"](hold=50.0, position=0.1, travel=0.1, capture=0.4),)
    joints = [draw(np.random.default_rng(3), tmp_path, latch) for _ in range(3)]
    batch, alone = JointBatch(joints), JointBatch(joints)
    for one in (batch, alone):
        one.set_state(torch.tensor([0.1, 0.1, 0.4]), torch.zeros(3))
        one.set_motor(one.joint_inertia * 400, one.joint_inertia * 30)
        one.command(torch.tensor([0.1, 0.2, 0.3]))
        for _ in range(20):
            step(one)
    batch.set_state(torch.tensor([0.4]), torch.tensor([0.0]), torch.tensor([1]))
    assert batch.time_s.tolist() == pytest.approx([0.02, 0.0, 0.02])
    assert [float(x) for x in batch._memories[0]] == [1.0, 0.0, 0.0]
    for one in (batch, alone):
        for _ in range(30):
            step(one)
    np.testing.assert_array_equal(batch.q[[0, 2]], alone.q[[0, 2]])
    assert abs(float(batch.q[1]) - 0.4) < 0.01 < abs(float(alone.q[1]) - 0.4)


def test_joints_that_need_too_many_steps_are_refused(tmp_path):
    batch = JointBatch([draw(np.random.default_rng(1), tmp_path)])
    batch.set_motor(torch.tensor([1e12]), torch.tensor([0.0]))
    assert_refused("at most 1000", step, batch)
