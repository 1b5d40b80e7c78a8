"""The object on the bench: one part on one joint, its asset as the product gets it, and its true gravity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_world.ode import World

G = 9.81
FAMILIES = ("pendulum", "door", "drawer", "slope")


@dataclass(frozen=True)
class Body:
    """A moving part on a hinge or slider, with the base at rest."""

    family: str
    """pendulum (hinge that lies), door (hinge that stands), drawer (level slider), slope (slanted slider)."""
    mass: float
    arm: float
    """m from the hinge's axis to the centre of mass; of a slider, from its origin, and of no effect."""
    inertia_centre: float
    """kg*m^2 about the centre of mass, the same in all directions."""
    axis: NDArray[np.float64]
    """(3,) unit vector in the base frame."""
    origin: NDArray[np.float64]
    """(3,) m, the joint's origin in the base frame."""
    com: NDArray[np.float64]
    """(3,) m, centre of mass in the part's frame: at joint state 0 parallel to the base's."""
    gravity: NDArray[np.float64]
    """(3,) m/s^2, base frame."""
    lower: float
    upper: float
    damping: float = 0.0
    """Loss that the asset knows: N*m*s/rad or N*s/m."""
    friction: float = 0.0
    """Dry friction that the asset knows: N*m or N."""

    @property
    def revolute(self) -> bool:
        return self.family in ("pendulum", "door")

    @property
    def kind(self) -> str:
        return "revolute" if self.revolute else "prismatic"

    @property
    def inertia(self) -> float:
        return self.inertia_centre + self.mass * self.arm**2 if self.revolute else self.mass

    @property
    def range(self) -> float:
        return self.upper - self.lower

    @property
    def force(self) -> float:
        """A usual force on this joint, N*m or N: what effects are sized by."""
        return {
            "pendulum": self.mass * G * self.arm, "door": 12 * self.inertia,
            "drawer": 3 * self.mass, "slope": 3 * self.mass,
        }[self.family]  # fmt: skip

    @property
    def speed(self) -> float:
        """A usual speed, rad/s or m/s."""
        return float(np.sqrt(2 * self.force / self.inertia)) if self.family == "pendulum" else self.range

    @property
    def rest(self) -> float:
        """Where it hangs (a pendulum), or the middle of its range."""
        cosine, sine, _ = self.gravity_terms()
        return float(np.arctan2(cosine, -sine)) if self.family == "pendulum" else 0.5 * (self.lower + self.upper)

    def gravity_terms(self) -> tuple[float, float, float]:
        """Gravity's force on the joint: that times cos q, that times sin q, and a constant."""
        if not self.revolute:
            return 0.0, 0.0, float(self.mass * self.axis @ self.gravity)
        weight = self.mass * self.gravity
        turned = np.cross(self.axis, self.com)
        return float(self.axis @ np.cross(self.com, weight)), float(self.axis @ np.cross(turned, weight)), 0.0

    def load_terms(self) -> tuple[float, float]:
        """Lever of the bearing's load that turns with the part, m, and the weight that does not, N."""
        weight = self.mass * self.gravity
        along = abs(float(weight @ self.axis))
        if self.revolute:
            return self.arm, along
        return 0.0, float(np.sqrt(weight @ weight - along**2))

    def world(self) -> World:
        """The joint just as the asset says."""
        cosine, sine, constant = self.gravity_terms()
        arm, axial = self.load_terms()
        return World(
            inertia=self.inertia, gravity_cosine=cosine, gravity_sine=sine, gravity_constant=constant,
            lower=self.lower, upper=self.upper, known_viscous=self.damping, dry=self.friction,
            mass=self.mass, arm=arm, load_axial=axial,
        )  # fmt: skip

    def urdf(self) -> str:
        """The asset: numbers of fixed width, so that no file is longer than another."""
        numbers = {
            "origin": _fixed(*self.origin), "axis": _fixed(*self.axis), "com": _fixed(*self.com),
            "mass": _fixed(self.mass), "i": _fixed(self.inertia_centre), "lower": _fixed(self.lower),
            "upper": _fixed(self.upper), "damping": _fixed(self.damping), "friction": _fixed(self.friction),
        }  # fmt: skip
        return _URDF.format(kind=f"{self.kind}", pad=" " if self.revolute else "", **numbers)


_URDF = """<?xml version="1.0"?>
<robot name="object">
  <link name="base"/>
  <link name="part">
    <inertial>
      <origin xyz="{com}" rpy="0 0 0"/>
      <mass value="{mass}"/>
      <inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/>
    </inertial>
  </link>
  <joint name="joint" type="{kind}"{pad}>
    <parent link="base"/>
    <child link="part"/>
    <origin xyz="{origin}" rpy="0 0 0"/>
    <axis xyz="{axis}"/>
    <limit lower="{lower}" upper="{upper}" effort="1000" velocity="1000"/>
    <dynamics damping="{damping}" friction="{friction}"/>
  </joint>
</robot>
"""


def _fixed(*values: float) -> str:
    return " ".join(f"{v:+.9e}" for v in values)


def _rounded(body: Body) -> Body:
    """The body whose numbers are just those that its URDF says."""
    arrays = {name: np.array([float(f"{v:.9e}") for v in getattr(body, name)]) for name in ("axis", "origin", "com")}
    names = ("mass", "inertia_centre", "lower", "upper", "damping", "friction")
    return replace(body, **arrays, **{name: float(f"{getattr(body, name):.9e}") for name in names})


def _turn(rng: np.random.Generator) -> NDArray[np.float64]:
    """(3, 3) a random rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def draw_body(rng: np.random.Generator, family: str) -> Body:
    """A body of real measures: a lid, a door, a drawer, a tray on a slope. Some assets know some losses already."""
    mass = float(np.exp(rng.uniform(np.log(0.3), np.log(4.0))))
    heading = rng.uniform(-np.pi, np.pi)
    slant = {
        "pendulum": rng.uniform(-0.35, 0.35), "door": np.pi / 2 - rng.uniform(0, 0.01),
        "drawer": 0.0, "slope": rng.choice([-1, 1]) * rng.uniform(0.07, 0.25),
    }[family]  # fmt: skip
    axis = np.array([np.cos(heading) * np.cos(slant), np.sin(heading) * np.cos(slant), np.sin(slant)])
    gravity = np.array([0.0, 0.0, -G])
    arm = rng.uniform(0.08, 0.4)
    down = gravity - (gravity @ axis) * axis
    down = np.cross(axis, [1.0, 0.3, 0.2]) if np.linalg.norm(down) < 1.0 else down
    down = down / np.linalg.norm(down)
    angle = rng.uniform(-0.5, 0.5) if family == "pendulum" else rng.uniform(-3, 3)
    across = np.cos(angle) * down + np.sin(angle) * np.cross(axis, down)
    com = arm * across + rng.uniform(-0.1, 0.1) * axis
    inertia_centre = mass * arm**2 * rng.uniform(0.08, 0.5)
    if family == "pendulum":
        lower, upper = -angle - rng.uniform(0.75, 1.2), -angle + rng.uniform(1.5, 2.0)
    elif family == "door":
        lower, upper = 0.0, rng.uniform(1.4, 2.2)
    else:
        lower, upper = 0.0, rng.uniform(0.25, 0.6)
    if rng.uniform() < 0.5:  # the frame of the base need not stand upright
        R = _turn(rng)
        axis, gravity, com = R @ axis, R @ gravity, R @ com
    if family != "pendulum" and rng.uniform() < 0.5:
        lower, upper = lower - 0.4 * upper, 0.6 * upper
    body = Body(
        family, mass, float(arm), float(inertia_centre), axis, rng.uniform(-0.3, 0.3, 3), com, gravity, lower, upper
    )
    if rng.uniform() < {"pendulum": 0.25, "door": 0.65, "drawer": 0.65, "slope": 0.4}[family]:
        known = {"damping": rng.uniform(0.05, 0.25) * body.inertia, "friction": rng.uniform(0.015, 0.05) * body.force}
        body = replace(body, **known)
    return _rounded(body)
