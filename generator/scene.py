"""A SAPIEN scene with one articulated object, posed by hand and rendered: colour, depth and part of every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.doctor import require_rendering
from freeart21.errors import FreeArtError
from freeart21.se3 import Array

_T_SAPIEN_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""SAPIEN's camera axes (x forward, y left, z up) from ours (x right, y down, z forward)."""


@dataclass(frozen=True)
class Picture:
    """One rendered view."""

    rgb: NDArray[np.uint8]
    """(height, width, 3)."""
    depth: NDArray[np.float32]
    """(height, width) z-depth, metres; 0 where there is no object."""
    side: NDArray[np.uint8]
    """(height, width): 0 no object, k for the k-th group of links, from 1."""


class Scene:
    """One object before a camera at rest; nothing is simulated."""

    def __init__(
        self,
        urdf: Path,
        groups: Sequence[Sequence[str]],
        camera: Camera,
        near: float,
        far: float,
        shader: str = "default",
    ) -> None:
        """`groups` are names of links, one group a label; `near` and `far` bound the depth, metres.

        Raises FreeArtError when this machine cannot render or SAPIEN cannot load the object.
        """
        require_rendering()
        import sapien

        sapien.render.set_log_level("error")
        sapien.render.set_camera_shader_dir(shader)
        self.camera = camera
        self._linear = shader == "trivial"  # the unlit shader gives linear colours, the others sRGB
        self._scene = sapien.Scene()
        self._scene.set_ambient_light([0.30, 0.30, 0.32])
        # A lamp above and behind the camera to the left, a weaker one from the right, and one from below.
        self._scene.add_directional_light([1.0, -0.55, -0.9], [1.9, 1.85, 1.75])
        self._scene.add_directional_light([0.7, 0.9, -0.2], [0.5, 0.52, 0.58])
        self._scene.add_directional_light([0.5, 0.1, 0.9], [0.25, 0.25, 0.27])
        self._object = _load(self._scene, urdf)
        self._label = _labels(self._object, groups, urdf)
        self._view = self._scene.add_camera(
            "camera", camera.width, camera.height, 2 * np.arctan(0.5 * camera.height / camera.K[1, 1]), near, far
        )
        self._view.set_perspective_parameters(
            near, far, camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], 0.0
        )
        self._view.entity.set_pose(sapien.Pose())

    def render(self, T_camera_object: Array, positions: dict[str, float]) -> Picture:
        """The view with the root link at `T_camera_object` (4, 4) and joints at `positions` (rad or m; others zero)."""
        import sapien

        T = _T_SAPIEN_CAMERA @ T_camera_object
        self._object.set_root_pose(sapien.Pose(T[:3, 3].astype(np.float32), se3.wxyz(T).astype(np.float32)))
        self._object.set_qpos(np.array([positions.get(j.name, 0.0) for j in self._object.active_joints], np.float32))
        self._scene.update_render()
        self._view.take_picture()
        rgb = self._view.get_picture("Color")[..., :3]
        if self._linear:
            rgb = _srgb(rgb)
        z = -self._view.get_picture("Position")[..., 2]
        side = self._label[np.minimum(self._view.get_picture("Segmentation")[..., 1], len(self._label) - 1)]
        return Picture(
            np.clip(np.rint(rgb * 255), 0, 255).astype(np.uint8),
            np.where(side > 0, z, 0).astype(np.float32),
            side,
        )

    def link_poses(self) -> dict[str, Array]:
        """Link name to its pose (4, 4) in the camera frame, as SAPIEN has it since the last `render`."""
        T_camera_sapien = se3.inverse(_T_SAPIEN_CAMERA)
        return {
            link.name: T_camera_sapien @ se3.pose_from_wxyz(link.entity_pose.p, link.entity_pose.q)
            for link in self._object.links
        }


def simulator() -> dict[str, str]:
    """Simulator, its version and the name of the render device, as they go into a truth's source."""
    require_rendering()
    import sapien

    lines = sapien.render.get_device_summary().splitlines()
    device = next((line.split(":", 1)[1].strip() for line in lines if line.strip().startswith("GPU:")), "unknown")
    return {"simulator": "SAPIEN", "simulator_version": sapien.__version__, "render_device": device}


def _srgb(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """sRGB, 0 to 1, of linear colours (IEC 61966-2-1)."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _load(scene: Any, urdf: Path) -> Any:
    """The articulation of a URDF without its collision shapes (nothing collides here) and without absent meshes."""
    loader = scene.create_urdf_loader()
    loader.fix_root_link = False
    try:
        builders = loader.parse(str(urdf))[0]
    except (RuntimeError, AssertionError, KeyError) as error:
        raise FreeArtError(f"SAPIEN cannot load {urdf}: {error}") from error
    for link in builders[0].link_builders:
        link.collision_records = []
        link.visual_records = [r for r in link.visual_records if not r.filename or Path(r.filename).is_file()]
    return builders[0].build(fix_root_link=False)


def _labels(articulation: Any, groups: Sequence[Sequence[str]], urdf: Path) -> NDArray[np.uint8]:
    """Per-scene entity id to group label; the last entry is for ids beyond all links."""
    ids = {link.name: link.entity.per_scene_id for link in articulation.links}
    labels = np.zeros(max(ids.values()) + 2, np.uint8)
    for label, names in enumerate(groups, start=1):
        for name in names:
            if name not in ids:
                raise FreeArtError(f"{urdf}: SAPIEN has no link '{name}'; links: {', '.join(ids)}")
            labels[ids[name]] = label
    return labels
