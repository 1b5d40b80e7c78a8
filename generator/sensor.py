"""Films a planned motion as a camera does: the scene rendered, then what its sensors (`generator.sensors`) add."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera_faults import CameraFaults
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator.motion import Plan, hull_points
from generator.scene import Picture, Scene, encode_srgb
from generator.sensors import check_sensor
from generator.sensors.base import Video
from generator.tof import incidence_cosine
from generator.urdf_object import LoadedObject

EXPOSURE_S = 1 / 60
"""Exposure time of blur, half a frame at 30 a second; at most a frame."""

_FAULTS = 6
"""Random stream of the camera's faults: frame i draws from [seed, _FAULTS, i]."""
_STREAM = 4
"""Random stream of the sensors: frame i draws from [seed, _STREAM, i]."""


class Sensor:
    """Films one planned motion."""

    def __init__(
        self,
        name: str,
        scene: Scene,
        plan: Plan,
        loaded: LoadedObject,
        meshes: tuple[Mesh, Mesh],
        seed: int,
        fps: float,
        faults: CameraFaults | None = None,
    ) -> None:
        """The sensor `name` before `scene`, filming `plan`.

        Args:
            name: one of `generator.sensors.SENSORS`, or several joined by '+', such as 'tof+blur'.
            scene: holds `loaded`.
            plan: the motion; the lamps are fixed in the world by its first camera pose.
            loaded: the object.
            meshes: parent side and child side in the object's frame at joint state zero.
            seed: of all random numbers.
            fps: frames per second.
            faults: faults of a real camera, applied last; a delayed depth picture has no other errors.

        Raises FreeArtError when a name is unknown or the names cannot be combined.
        """
        self.name = name
        self._faults, self._fps, self._nominal_camera = faults, fps, scene.camera
        if faults is not None:
            scene.set_camera(faults.actual_camera(scene.camera))
        self._scene, self._plan, self._loaded, self._seed = scene, plan, loaded, seed
        self._exposure = min(EXPOSURE_S * fps, 1.0)
        self._hulls = hull_points(meshes[0]), hull_points(meshes[1])
        scene.fix_lamps(plan.Ts_camera_world[0])
        self._started_frame: int | None = None
        video = Video(scene, plan, loaded.joint, meshes, seed)
        self.models = tuple(model(video) for model in check_sensor(name))
        pieces = [piece for model in self.models for piece in model.pieces()]
        self._has_pieces = bool(pieces)
        if pieces:
            scene.set_props(pieces)

    def shoot(self, i: int) -> Picture:
        """Frame `i` of the video as the camera gives it, with its true labels: 1 the scored joint's parent side, 2 its
        child side. It does not depend on the frames before."""
        count = max(model.sub_frames(self.motion_px(i)) for model in self.models) if self._averages else 1
        faults, then = self._faults, None
        if faults is not None and faults.depth_delay:  # clean depth at the earlier time
            self._draw(i - faults.depth_delay * self._fps)
            self._started_frame, then = None, self._scene.depth_and_side()[0]
        light = self._light(i, count)
        if self._started_frame != i:
            self._draw(i)
        self._started_frame = None
        rgb = (
            self._scene.rgb() if light is None else encode_srgb((light + self._scene.linear_rgb()) / np.float32(count))
        )
        depth, side = self._scene.depth_and_side()
        rng = np.random.default_rng([self._seed, _STREAM, i])
        for model in self.models:
            depth = model.depth(depth, rng)
        if faults is not None:
            depth = depth if then is None else then
            bright = (rgb.mean(-1) / 255).astype(np.float32)
            cosine = incidence_cosine(depth, self._scene.camera.rays())
            rng = np.random.default_rng([self._seed, _FAULTS, i])
            depth = faults.depth(depth, bright, cosine, self._nominal_camera, rng)
            rgb = faults.colour(rgb, i / max(len(self._plan.states) - 1, 1))
        return Picture(rgb, depth, side)

    def start_drawing(self, i: int) -> None:
        """Let the renderer start frame `i` while the caller does other work; `shoot` then fetches the picture."""
        if not self._averages and not (self._faults is not None and self._faults.depth_delay):
            self._draw(i)
            self._started_frame = i

    def _draw(self, t: float) -> None:
        """Draw the scene at time `t`, in frames."""
        held, joint = self._loaded.asset.held, self._loaded.joint.name
        state = float(np.interp(t, np.arange(len(self._plan.states)), self._plan.states))
        T = interpolate_pose(self._plan.Ts_camera_object, t)
        pieces = self._piece_poses(t, T, state) if self._has_pieces else None
        self._scene.shoot(T, {**held, joint: state}, interpolate_pose(self._plan.Ts_camera_world, t), pieces)

    @property
    def _averages(self) -> bool:
        return any(model.averages for model in self.models)

    def _piece_poses(self, t: float, T_camera_object: Array, state: float) -> Array:
        return np.concatenate([model.piece_poses(t, T_camera_object, state) for model in self.models])

    def _light(self, i: int, count: int) -> NDArray[np.float32] | None:
        """Sum of the light of the `count` sub-frames of frame `i` without the middle one; None for a single one."""
        light = None
        for k in range(count):
            if k != count // 2:
                self._draw(i + self._exposure * ((k + 0.5) / count - 0.5))
                light = self._scene.linear_rgb() if light is None else light + self._scene.linear_rgb()
        return light

    def motion_px(self, i: int) -> float:
        """Largest motion of points of object and hand in the picture during the exposure of frame `i`, pixels."""
        ends = []
        for t in (i - self._exposure / 2, i + self._exposure / 2):
            T = interpolate_pose(self._plan.Ts_camera_object, t)
            state = float(np.interp(t, np.arange(len(self._plan.states)), self._plan.states))
            Ts = T, T @ self._loaded.joint.transform(state)
            points = np.concatenate([se3.transform(T, hull) for T, hull in zip(Ts, self._hulls, strict=True)])
            points = np.concatenate([points, self._piece_poses(t, T, state)[:, :3, 3]])
            ends.append(self._scene.camera.project(points))
        return float(np.nanmax(np.linalg.norm(ends[1] - ends[0], axis=1), initial=0.0))


def interpolate_pose(Ts: Array, t: float) -> Array:
    """The pose (4, 4) at time `t`, in frames, of poses (n, 4, 4): constant twist between frames and beyond the ends."""
    k = int(np.clip(np.floor(t), 0, max(len(Ts) - 2, 0)))
    if t == k or len(Ts) == 1:
        return np.asarray(Ts[k])
    if t == k + 1:
        return np.asarray(Ts[k + 1])
    return np.asarray(Ts[k] @ se3.exp_se3((t - k) * se3.log_se3(se3.inverse(Ts[k]) @ Ts[k + 1])))
