"""What stands before the sensor: a box on a joint, as its maker gives it (the URDF) and as it really is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.world import laws as w

GRAVITY = 9.81


@dataclass(frozen=True)
class Machine:
    """A joint as given. Base frame: z up, but for a drawer's slope; the joint's axis goes through the origin.

    `mass` kg, `lever` m from axis to centre of mass (0 of a drawer), `inertia` kg m^2 about the axis (kg of a drawer),
    `size` (3,) m of the box, `slope` rad by which a drawer runs downhill, `low`, `high` the stops, `stiffness`,
    `damping` of the drive or 0.
    """

    kind: str
    mass: float
    lever: float
    inertia: float
    size: tuple[float, float, float]
    slope: float
    low: float
    high: float
    stiffness: float = 0.0
    damping: float = 0.0

    @property
    def slides(self) -> bool:
        return self.kind == "drawer"

    @property
    def light(self) -> bool:
        """Gravity hardly moves it."""
        return self.kind in ("door", "drawer")

    @property
    def axis(self) -> np.ndarray:
        """(3,) unit; a lid's is turned so that gravity closes it."""
        axes = {"door": (0.0, 0.0, 1.0), "drawer": (1.0, 0.0, 0.0), "lid": (0.0, -1.0, 0.0)}
        return np.array(axes.get(self.kind, (0.0, 1.0, 0.0)))

    @property
    def arm(self) -> np.ndarray:
        """(3,) m: the centre of mass at joint state zero."""
        return self.lever * np.array([0.0, 0, -1] if self.kind in ("pendulum", "arm") else [1.0, 0, 0])

    @property
    def gravity(self) -> np.ndarray:
        """(3,) m/s^2 in the base's frame, as given."""
        return GRAVITY * np.array([math.sin(self.slope), 0, -math.cos(self.slope)])

    @property
    def weight(self) -> float:
        """Largest torque or force of gravity, N m or N."""
        return self.mass * GRAVITY * (math.sin(self.slope) if self.slides else self.lever)

    @property
    def omega(self) -> float:
        """rad/s: of a small swing, or of pushes that suit a machine that has none."""
        hangs = self.kind in ("pendulum", "arm")
        return math.sqrt(self.weight / self.inertia) if hangs else 4.0 if self.slides else 2.0


def draw_machine(kind: str, rng: np.random.Generator) -> Machine:
    """One of its kind: .1 to 1 m, .05 to 20 kg by its volume at 60 to 600 kg/m^3 (hollow wood to solid)."""
    length = math.exp(rng.uniform(math.log(0.12), math.log(0.6 if kind in ("pendulum", "arm") else 0.9)))
    width, thick = length * rng.uniform(0.2, 0.8), length * rng.uniform(0.04, 0.12)
    mass = float(np.clip(rng.uniform(60, 600) * length * width * thick, 0.05, 20.0))
    if kind == "drawer":
        slope = 0.0 if rng.random() < 0.5 else math.radians(rng.uniform(3, 9))
        return Machine(kind, mass, 0.0, mass, (length, width, 0.4 * length), slope, -0.9, 0.9)
    if kind == "arm":  # a weight near the end of a light beam
        lever = 0.8 * length
        inertia = mass * (lever**2 + (0.3 * length) ** 2 / 12)
        stiffness = mass * GRAVITY * lever * rng.uniform(2, 10)
        damping = 2 * rng.uniform(0.25, 0.7) * math.sqrt(stiffness * inertia)
        return Machine(kind, mass, lever, inertia, (0.3 * length,) * 3, 0.0, -2.8, 2.8, stiffness, damping)
    stops = {"pendulum": (-3.1, 3.1), "lid": (0.0, 2.0), "door": (-2.2, 2.2)}[kind]
    inertia = mass * (length**2 + thick**2) / 12 + mass * (length / 2) ** 2
    sizes = {"pendulum": (thick, width, length), "lid": (length, width, thick), "door": (length, thick, width)}
    return Machine(kind, mass, length / 2, inertia, sizes[kind], 0.0, *stops)


@dataclass(frozen=True)
class Nuisance:
    """What is never as given: shares of inertia and weight, and the base's tilt about x and y, rad."""

    inertia: float = 0.0
    weight: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)


def draw_nuisance(machine: Machine, rng: np.random.Generator) -> Nuisance:
    """Inertia within 10 % (a drawer's mass 5 %), centre of mass within 5 %, base tilted by .3 degrees."""
    way = rng.uniform(0, 2 * math.pi)
    tilt = math.radians(0.3) * np.array([math.cos(way), math.sin(way)])
    weight = float(rng.uniform(-0.05, 0.05))
    inertia = weight if machine.slides else float(rng.uniform(-0.1, 0.1))
    return Nuisance(inertia, weight, (float(tilt[0]), float(tilt[1])))


def truth(machine: Machine, nuisance: Nuisance) -> np.ndarray:
    """Parameters of `laws` of the real machine without any effect."""
    p = w.parameters()
    p[w.M] = machine.inertia * (1 + nuisance.inertia)
    p[w.MASS], p[w.LOW], p[w.HIGH] = machine.mass, machine.low, machine.high
    p[w.KP], p[w.KD] = machine.stiffness, machine.damping
    (a, b), g = nuisance.tilt, machine.gravity
    g = g + np.cross([a, b, 0.0], g)
    heavy = machine.mass * (1 + nuisance.weight)
    if machine.slides:
        p[w.LEVER], p[w.GC], p[w.AXIAL] = 0.0, heavy * (machine.axis @ g), heavy * abs(g[2])
        return p
    p[w.LEVER] = machine.lever * (1 + nuisance.weight)
    r0 = machine.arm / machine.lever
    r1 = np.cross(machine.axis, r0)  # the arm points along r0 cos q + r1 sin q
    turn = machine.mass * p[w.LEVER]
    p[w.GA] = turn * float(machine.axis @ np.cross(r0, g))
    p[w.GB] = turn * float(machine.axis @ np.cross(r1, g))
    p[w.AXIAL] = machine.mass * abs(float(machine.axis @ g))
    return p


def urdf(machine: Machine) -> str:
    """The machine as published, a base and a box; nothing in it knows of the case."""
    a, b, c = machine.size
    own = machine.mass / 12 * np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    if not machine.slides:
        k = int(np.argmax(np.abs(machine.axis)))
        own[k] = machine.inertia - machine.mass * machine.lever**2
        others = [i for i in range(3) if i != k]
        if own[others[0]] + own[others[1]] < own[k]:
            own[others] = own[k]
    x, y, z = machine.arm
    box = " ".join(f"{s:.5f}" for s in machine.size)
    axis = " ".join(f"{a:.0f}" for a in machine.axis)
    kind = "prismatic" if machine.slides else "revolute"
    return f"""<?xml version="1.0"?>
<robot name="machine">
  <link name="base">
    <inertial>
      <origin xyz="0 0 0"/>
      <mass value="1.0000000"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
    </inertial>
  </link>
  <link name="part">
    <inertial>
      <origin xyz="{x:.7f} {y:.7f} {z:.7f}"/>
      <mass value="{machine.mass:.7f}"/>
      <inertia ixx="{own[0]:.9e}" ixy="0" ixz="0" iyy="{own[1]:.9e}" iyz="0" izz="{own[2]:.9e}"/>
    </inertial>
    <visual>
      <origin xyz="{x:.7f} {y:.7f} {z:.7f}"/>
      <geometry><box size="{box}"/></geometry>
    </visual>
  </link>
  <joint name="joint" type="{kind}">
    <parent link="base"/>
    <child link="part"/>
    <origin xyz="0 0 0" rpy="0 0 0"/>
    <axis xyz="{axis}"/>
    <limit lower="{machine.low:.4f}" upper="{machine.high:.4f}" effort="1000" velocity="100"/>
  </joint>
</robot>
"""
