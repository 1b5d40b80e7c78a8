"""What the camera adds to a rendered video: named sensors, each of which may be joined with others by '+'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator.motion import Plan
from generator.partnet import PartNetObject
from generator.scene import Scene

SENSORS: tuple[str, ...] = ("clean", "noise2")
"""Names of the sensors."""

NOISE2_SHARE = 0.02
"""Standard deviation of noise2's depth, as a share of the depth."""

_STREAM = 4
"""Random stream of the sensors: frame i draws from [seed, _STREAM, i], whatever was drawn before."""


@dataclass(frozen=True)
class Shot:
    """One frame of the video, as the camera gives it, and what it truly shows."""

    rgb: NDArray[np.uint8]
    """(height, width, 3)."""
    depth: NDArray[np.float32]
    """(height, width) z-depth, metres; 0 where there is none."""
    mask: NDArray[np.bool_]
    """(height, width) where the object is seen: `side` > 0."""
    side: NDArray[np.uint8]
    """(height, width): 0 no object, 1 the scored joint's parent side, 2 its child side; true, whatever `depth` says."""


DepthModel = Callable[[NDArray[np.float32], np.random.Generator], NDArray[np.float32]]
"""What a depth camera makes of a true depth map (0 = none)."""


class Sensor:
    """Films one planned motion. Made by `make_sensor`."""

    def __init__(self, name: str, scene: Scene, plan: Plan, loaded: PartNetObject, seed: int) -> None:
        self.name = name
        self._scene, self._plan, self._loaded, self._seed = scene, plan, loaded, seed
        self._Ts_camera_world: Array | None = getattr(plan, "Ts_camera_world", None)
        if self._Ts_camera_world is not None:
            scene.fix_lamps(self._Ts_camera_world[0])
        self._depth_model: DepthModel | None = noise2 if "noise2" in name.split("+") else None

    def shoot(self, i: int) -> Shot:
        """Frame `i` of the video: the same whatever was shot before."""
        positions = {**self._loaded.asset.held, self._loaded.joint.name: float(self._plan.states[i])}
        T_camera_world = None if self._Ts_camera_world is None else self._Ts_camera_world[i]
        self._scene.shoot(self._plan.Ts_camera_object[i], positions, T_camera_world)
        rgb = self._scene.rgb()
        depth, side = self._scene.depth_and_side()
        if self._depth_model is not None:
            depth = self._depth_model(depth, np.random.default_rng([self._seed, _STREAM, i]))
        return Shot(rgb, depth, side > 0, side)


def make_sensor(
    name: str,
    scene: Scene,
    plan: Plan,
    loaded: PartNetObject,
    meshes: tuple[Mesh, Mesh],
    seed: int,
    fps: float,
) -> Sensor:
    """The sensor `name` before `scene`, filming `plan`.

    Args:
        name: one of `SENSORS`, or several joined by '+', such as 'tof+blur'.
        scene: holds `loaded`.
        plan: the motion; its first camera says where the lamps stand in the world.
        loaded: the object.
        meshes: parent side and child side in the object's frame at joint state zero.
        seed: of everything random.
        fps: frames per second.

    Raises FreeArtError when the name is unknown or joins what cannot be joined.
    """
    check_sensor(name)
    return Sensor(name, scene, plan, loaded, seed)


def check_sensor(name: str) -> None:
    """Raises FreeArtError unless `name` is a sensor or sensors joined by '+'."""
    parts = name.split("+")
    for part in parts:
        if part not in SENSORS:
            raise FreeArtError(f"unknown sensor '{part}'; sensors: {', '.join(SENSORS)}, or several joined by '+'")
    if len(set(parts)) < len(parts) or ("clean" in parts and len(parts) > 1) or {"noise2", "tof"} <= set(parts):
        raise FreeArtError(
            f"sensor '{name}' joins what does not go together: each name once, clean alone, noise2 or tof but not both"
        )


def noise2(depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Depth with Gaussian noise of 2 % of itself, drawn afresh for every pixel; 0 stays 0.

    It knows no edges, angles or materials.
    """
    noise = rng.standard_normal(depth.shape, np.float32)
    return depth * (np.float32(1) + np.float32(NOISE2_SHARE) * noise)
