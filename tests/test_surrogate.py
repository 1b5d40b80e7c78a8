"""The fast simulation says what SAPIEN says, with every effect that it knows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from freeart21.effects import EFFECTS
from freeart21.files.asset import read_asset
from freeart21.measured import Measured
from freeart21.mechanics import Actuator, interpolate_series
from generator.simulate import roll_out
from simgap.models import laws
from simgap.models.surrogate import (
    Inputs,
    make_plant,
    simulate,
)

MASS, ARM, G = 1.6, 0.5, 9.81
GRAVITY = np.array([0.0, 0.0, -G])


def asset_at(folder: Path, kind: str, *effects, axis: str = "0 1 0", lower: float = -50, upper: float = 50):
    path = folder / "bob.urdf"
    path.write_text(f"""<robot name="bob"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 {-ARM}"/>
        <mass value="{MASS}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="{kind}"><parent link="base"/><child link="bob"/><origin xyz="0 0 1" rpy="0 0 0"/>
        <axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}"/></joint></robot>""")
    return replace(read_asset(path), effects={"j": effects})


def measured_of(kind: str, actuator: Actuator | None = None, gravity=GRAVITY) -> Measured:
    return Measured("j", kind, np.asarray(gravity, float), 1000.0, "recorded", None, actuator)


def make_effect(name: str, **values: float):
    return EFFECTS[name](**values)


FREE = {
    "viscous_damping": make_effect("viscous_damping", coefficient=0.3),
    "quadratic_drag": make_effect("quadratic_drag", coefficient=0.1),
    "coulomb_friction": make_effect("coulomb_friction", level=0.4),
    "stribeck_friction": make_effect("stribeck_friction", level=0.2, rise=0.3, speed=0.3),
    "load_friction": make_effect("load_friction", coefficient=0.01),
    "gear_friction": make_effect("gear_friction", coefficient=0.05),
    "return_spring": make_effect("return_spring", stiffness=4.0, rest=0.2),
    "detent": make_effect("detent", peak=1.0, centre=0.3, width=0.08),
    "latch": make_effect("latch", hold=2.0, position=0.1, travel=0.1, capture=0.4),
    "presliding_friction": make_effect("presliding_friction", level=0.3, travel=0.05),
    "force_over_position": EFFECTS["force_over_position"](0.4, -0.2, 0.3, 0.0, 0.2, -0.3, 0.0, 0.1, -0.5, 0.7),
    "friction_over_position": EFFECTS["friction_over_position"](0.4, 0.2, 0.3, 0.1, 0.2, 0.3, 0.1, 0.1, -0.5, 0.7),
    "armature": make_effect("armature", value=0.2),
    "encoder_offset": make_effect("encoder_offset", offset=0.05),
    "encoder_scale": make_effect("encoder_scale", factor=1.1),
}


def test_the_kernel_has_every_law_of_the_library():
    lawful = {name for name, cls in EFFECTS.items() if cls.acts in ("force", "drive", "stop")}
    assert set(laws.LAWS) == lawful
    rng = np.random.default_rng(0)
    for name in lawful:
        cls = EFFECTS[name]
        numbers = rng.uniform(0.1, 0.9, len(cls.parameters()))
        q, qd, load, memory = *rng.uniform(-1, 1, 2).tolist(), 2.0, 1.0
        got = laws.law(laws.LAWS[name], q, qd, load, memory, numbers, 0)
        assert got == pytest.approx(float(cls.law(q, qd, load, memory, *numbers)), rel=1e-12), name
        caught = laws.remember(laws.LAWS[name], q, 1.0, numbers, 0)
        assert caught == float(cls.remember(q, 1.0, *numbers)), name


@pytest.mark.parametrize(
    "bounce",
    [
        ("end_stop_bounce", {"restitution": 0.0}),
        ("end_stop_bounce", {"restitution": 0.6}),
        ("armature", {"value": 0.05, "throw_back": 0.6}),
        ("armature", {"value": 0.1, "throw_back": 0.4, "swing": 0.01}),
    ],
)
def test_impacts_are_sapiens(tmp_path: Path, bounce: tuple[str, dict[str, float]]):
    effects = (make_effect(bounce[0], **bounce[1]), make_effect("viscous_damping", coefficient=0.05))
    asset = asset_at(tmp_path, "revolute", *effects, lower=-0.4, upper=1.5)
    theirs = roll_out(asset, 1.2, 0.0, duration_s=4)
    ours = simulate(make_plant(asset, measured_of("revolute")), effects, theirs.times_s, 1.2)
    assert np.abs(ours - theirs.q).max() < 4e-3
    assert ours.min() >= -0.4 - 1e-12


@pytest.mark.parametrize(
    "names",
    [
        (),
        ("actuator_gain",),
        ("actuator_delay",),
        ("backlash",),
        ("coulomb_friction",),
        ("gear_friction",),
        ("actuator_gain", "coulomb_friction", "gear_friction"),
        ("backlash", "gear_friction"),
    ],
)
def test_a_servo_is_sapiens(tmp_path: Path, names: tuple[str, ...]):
    library = {
        "actuator_gain": make_effect("actuator_gain", factor=0.7),
        "actuator_delay": make_effect("actuator_delay", seconds=0.03),
        "backlash": make_effect("backlash", width=0.1, drive_inertia=0.1),
        "coulomb_friction": make_effect("coulomb_friction", level=0.5),
        "gear_friction": make_effect("gear_friction", coefficient=0.2),
    }
    effects = tuple(library[name] for name in names)
    asset = asset_at(tmp_path, "revolute", *effects)
    times = np.arange(3001) * 1e-3
    ticks = times[::10]
    command = 0.4 * np.sin(4 * ticks)
    law = Actuator(interpolate_series(ticks, command, "held"), 40.0, 3.0)
    theirs = roll_out(asset, 0.0, duration_s=3, actuator=law)
    plant = make_plant(asset, measured_of("revolute", Actuator(None, 40.0, 3.0)))
    inputs = Inputs(ticks, command, np.zeros(len(ticks)), np.zeros(len(ticks)))
    ours = simulate(plant, effects, theirs.times_s, 0.0, 0.0, inputs)
    assert np.abs(ours - theirs.q).max() < 4e-3 * np.ptp(theirs.q)
