"""What a trial needs of an engine."""

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
class EngineJoint:
    """A movable joint as an engine has it."""

    name: str
    parent: str
    child: str
    lower: float
    upper: float
    """rad or m, infinite without a limit."""


@dataclass(frozen=True)
class Setting:
    """The scene that an asset is loaded into."""

    fixed: bool
    """Whether the root link is nailed down at the world's origin."""
    gravity: bool
    floor: bool
    """Whether there is a plane at z = 0."""


class World(ABC):
    """An asset in a scene of one engine."""

    joints: tuple[EngineJoint, ...]
    """Those that move."""
    parents: dict[str, str | None]
    """Link to the link that it hangs on; of all links."""
    nailed: bool = False
    """Whether the engine holds the root although it was not asked to."""

    @abstractmethod
    def inertials(self) -> dict[str, UrdfInertial]:
        """Link to mass properties, as the engine has them."""

    @abstractmethod
    def put(self, q: Mapping[str, float], qd: Mapping[str, float] | None = None) -> None:
        """Put the joints at positions `q` with velocities `qd` (zero when not given), rad or m."""

    @abstractmethod
    def place(self, T_world_root: Array) -> None:
        """Put the root link's frame at (4, 4), at rest; only where it is not fixed."""

    @abstractmethod
    def state(self) -> tuple[dict[str, float], dict[str, float]]:
        """Positions and velocities of the joints."""

    @abstractmethod
    def poses(self) -> dict[str, Array]:
        """Link to T_world_link (4, 4), in the state of now."""

    @abstractmethod
    def advance(self, seconds: float, push: Mapping[str, float] | None = None) -> None:
        """Simulate with constant forces `push`, N m or N, on the joints."""

    def energy(self) -> float | None:
        """J, where the engine says it; else it is computed from what else it says."""
        return None

    def lowest(self) -> float | None:
        """Height, m, of the lowest point that collides, where the engine can say it."""
        return None


MODULES = {"sapien": "sapien", "mujoco": "mujoco", "pybullet": "pybullet", "drake": "pydrake"}
"""Engine to the package whose import says whether it is installed."""
SETTINGS = {
    "sapien": "step 2 ms, 25 position iterations, contact offset 2 mm, friction 0.5, no sleeping, no damping of links, "
    "joint friction as the URDF's (by a saturated damper)",
    "mujoco": "the file's own solver and contact options, step at most 2 ms; limits of URDFs as hard as that allows; "
    "a plane with default contact",
    "pybullet": "step 2 ms, 100 solver iterations, inertia from the file, no damping of links, neighbours do not "
    "collide, friction 0.5, joint friction as the URDF's (by a velocity motor)",
    "drake": "discrete step 2 ms, hydroelastic contact (compliant, default modulus), friction 0.5, joint friction as "
    "the URDF's (by a damper with a limit)",
}
"""What a reader of the numbers has to know."""


def load_world(engine: str, file: Path, folder: Path, setting: Setting) -> World:
    """The asset of a URDF (or, in MuJoCo, an MJCF) in a fresh scene of the engine; raises what the engine raises."""
    module = importlib.import_module(f"export.check.engines.{engine}_world")
    world: World = module.load(file, folder, setting)
    return world
