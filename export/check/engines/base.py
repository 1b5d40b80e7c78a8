"""Interface of an engine for trials."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from freeart21.files.urdf import UrdfInertial
from freeart21.se3 import Array

GRAVITY = 9.81
"""m/s^2, along the world's -z."""


@dataclass(frozen=True)
class Setting:
    """The scene that an asset is loaded into."""

    fixed: bool
    """Whether the root link is fixed at the world's origin."""
    gravity: bool
    floor: bool
    """Whether there is a plane at z = 0."""


class World(ABC):
    """An asset in a scene of one engine."""

    limits: dict[str, tuple[float, float]]
    """Movable joint to its limits, rad or m, infinite without one."""
    parents: dict[str, str | None]
    """Link name to its parent's, for all links."""
    root_held: bool = False
    """Whether the engine holds the root although it was not asked to."""

    @abstractmethod
    def inertials(self) -> dict[str, UrdfInertial]:
        """Link name to mass properties in the engine."""

    @abstractmethod
    def put(self, q: Mapping[str, float], qd: Mapping[str, float] | None = None) -> None:
        """Set joint positions `q` and velocities `qd` (default zero), rad or m."""

    @abstractmethod
    def place(self, T_world_root: Array) -> None:
        """Set the root link's pose (4, 4), at rest; only where it is not fixed."""

    @abstractmethod
    def state(self) -> tuple[dict[str, float], dict[str, float]]:
        """Positions and velocities of the joints."""

    @abstractmethod
    def poses(self) -> dict[str, Array]:
        """Link name to T_world_link (4, 4) in the current state."""

    @abstractmethod
    def advance(self, seconds: float, push: Mapping[str, float] | None = None) -> None:
        """Simulate with constant forces `push`, N m or N, on the joints."""

    def energy(self) -> float | None:
        """Total energy, J, where the engine has it; otherwise the caller computes it."""
        return None

    def lowest(self) -> float | None:
        """Height, m, of the lowest colliding point, where the engine has it."""
        return None


MODULES = {"sapien": "sapien", "mujoco": "mujoco", "pybullet": "pybullet", "drake": "pydrake"}
"""Engine to the package that must be installed."""
SETTINGS = {
    "sapien": "step 2 ms, 25 position iterations, contact offset 2 mm, friction 0.5, no sleeping, no damping of links, "
    "joint friction as the URDF's (by a saturated damper)",
    "mujoco": "the file's own solver and contact options, step at most 2 ms; limits of URDFs as hard as that allows; "
    "a plane with default contact",
    "pybullet": "step 1 ms, 100 solver iterations, inertia from the file, no damping of links, neighbours do not "
    "collide, friction 0.5, joint friction as the URDF's (by a velocity motor)",
    "drake": "discrete step 2 ms, SAP, hydroelastic contact (compliant, 1e8 Pa per kg, at most 1e9), friction 0.5, "
    "joint friction as the URDF's (by a damper with a limit)",
}
"""Settings for readers of the report."""


def load_world(engine: str, file: Path, folder: Path, setting: Setting) -> World:
    """The asset of a URDF (for MuJoCo also an MJCF) in a new scene; raises whatever the engine raises."""
    module = importlib.import_module(f"export.check.engines.{engine}_world")
    world: World = module.load(file, folder, setting)
    return world
