"""Renders one articulated object in SAPIEN at given poses: colour, depth and part of every pixel."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.camera_faults import srgb_decode
from freeart21.doctor import require_rendering
from freeart21.errors import FreeArtError
from freeart21.files.urdf import format_urdf, read_file_names, read_urdf
from freeart21.files.urdf_files import find_root
from freeart21.se3 import Array
from generator.model import SHINE
from generator.partnet import URDF_NAME
from generator.partnet_files import Gaps, sapien_urdf
from generator.sapien_asset import read_files_now
from generator.surface import Surface, crease_normals, srgb_bytes
from generator.textures import plain
from generator.urdf_object import FLOATING, read_visuals

_T_SAPIEN_CAMERA = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""SAPIEN's camera axes (x forward, y left, z up) from ours (x right, y down, z forward)."""

_MOST_VIEWS = 4
"""Picture sizes for which the engine's buffers are cached: making them takes as long as a picture."""


@dataclass(frozen=True)
class Picture:
    """One rendered view."""

    rgb: NDArray[np.uint8]
    """(height, width, 3)."""
    depth: NDArray[np.float32]
    """(height, width) z-depth, metres; 0 for background."""
    side: NDArray[np.uint8]
    """(height, width): 0 no object, k for the k-th group of links, from 1."""


@dataclass(frozen=True)
class Skin:
    """A textured surface."""

    vertices: Array
    """(V, 3) metres."""
    faces: NDArray[np.int64]
    """(F, 3)."""
    normals: Array
    """(V, 3)."""
    uv: Array
    """(V, 2)."""
    picture: NDArray[np.uint8]
    """(h, w, 3) RGB texture, repeated."""
    roughness: float = 0.6
    """0 a mirror, 1 chalk."""
    gloss: float = 0.05
    """Specular strength, 0 to 1, as MTL's Ks; the default is about that of skin and cloth."""


class Scene:
    """One object in front of a camera; nothing is simulated.

    The engine's poses are single precision. So the camera is at the engine's origin, everything is posed in its frame,
    and a moving camera moves the lamps instead.
    """

    def __init__(
        self,
        urdf: Path,
        groups: Sequence[Sequence[str]],
        camera: Camera,
        near: float,
        far: float,
        shader: str = "default",
        root: Path | None = None,
    ) -> None:
        """`groups` are the link names of each label, from label 1; `near` and `far` bound the depth, metres; files are
        in `root`. SAPIEN reads the files of a PartNet-Mobility folder; the meshes of any other URDF are read by us.

        Raises FreeArtError when this machine cannot render or SAPIEN cannot load the object.
        """
        require_rendering()
        import sapien

        sapien.render.set_log_level("error")
        sapien.render.set_camera_shader_dir(shader)
        self._linear = shader == "trivial"  # the unlit shader gives linear colours, the others sRGB
        self._scene = sapien.Scene()
        self._scene.set_ambient_light([0.30, 0.30, 0.32])
        # A lamp above and behind the camera to the left, a weaker one from the right, and one from below.
        self._lamps = [
            lamp.entity
            for lamp in (
                self._scene.add_directional_light([1.0, -0.55, -0.9], [1.9, 1.85, 1.75]),
                self._scene.add_directional_light([0.7, 0.9, -0.2], [0.5, 0.52, 0.58]),
                self._scene.add_directional_light([0.5, 0.1, 0.9], [0.25, 0.25, 0.27]),
            )
        ]
        self._lamps_at_rest = [lamp.pose for lamp in self._lamps]
        self._R_camera_world = self._R_now = np.eye(3)
        self._strength: NDArray[np.float32] | None = None
        self._props: list[Any] = []
        self._prop_gloss: dict[int, list[float]] = {}
        self._props_shown = False
        self._object = _load(self._scene, urdf, root)
        self._joint_names = [joint.name for joint in self._object.active_joints]
        self._label = _group_labels(self._object, groups, urdf)
        self._depths = near, far
        self._views: dict[tuple[int, int], Any] = {}
        self.set_camera(camera)

    def set_camera(self, camera: Camera) -> None:
        """Set the intrinsics and size of the following pictures; the camera's pose stays."""
        import sapien

        K, size, (near, far) = camera.K, (camera.width, camera.height), self._depths
        view = self._views.pop(size, None)
        if view is None:
            if len(self._views) == _MOST_VIEWS:
                self._scene.remove_entity(self._views.pop(next(iter(self._views))).entity)
            view = self._scene.add_camera("camera", *size, 2 * np.arctan(0.5 * camera.height / K[1, 1]), near, far)
            view.entity.set_pose(sapien.Pose())
        view.set_perspective_parameters(near, far, K[0, 0], K[1, 1], K[0, 2], K[1, 2], 0.0)
        self._views[size] = view
        self.camera, self._view = camera, view

    def fix_lamps(self, T_camera_world: Array) -> None:
        """Fix the lamps in the world where they are for a camera at `T_camera_world` (4, 4)."""
        self._R_camera_world = np.asarray(T_camera_world, float)[:3, :3]

    def render(
        self, T_camera_object: Array, positions: dict[str, float], T_camera_world: Array | None = None
    ) -> Picture:
        """Render with the root link at `T_camera_object` (4, 4) and joints at `positions` (rad or m; others zero).

        With `T_camera_world` (4, 4) the lamps are fixed in the world (see `fix_lamps`), without it they move with the
        camera. Lamps are infinitely far away, so that only their direction matters.
        """
        self.shoot(T_camera_object, positions, T_camera_world)
        return Picture(self.rgb(), *self.depth_and_side())

    def set_props(self, things: Sequence[Sequence[Skin]]) -> None:
        """Replace the rigid props besides the object; they are drawn in views that give their poses."""
        import sapien

        for entity in self._props:
            self._scene.remove_entity(entity)
        self._props = [sapien.Entity() for _ in things]
        for entity, skins in zip(self._props, things, strict=True):
            entity.add_component(_render_body(skins))
            entity.set_pose(_out_of_view())
            self._scene.add_entity(entity)
        glosses = [[skin.gloss for skin in skins] for skins in things]
        self._prop_gloss = {e.per_scene_id: gloss for e, gloss in zip(self._props, glosses, strict=True)}
        self._props_shown, self._strength = False, None

    def shoot(
        self,
        T_camera_object: Array,
        positions: dict[str, float],
        T_camera_world: Array | None = None,
        Ts_camera_prop: Array | None = None,
    ) -> None:
        """Draw a view; other methods fetch its pictures. Arguments as in `render`.

        `Ts_camera_prop` (n, 4, 4) are the poses of the props in the order of `set_props`; without it none is drawn.
        """
        import sapien

        if Ts_camera_prop is not None:
            Ts = _T_SAPIEN_CAMERA @ Ts_camera_prop
            for entity, t, q in zip(self._props, Ts[:, :3, 3], se3.wxyz(Ts), strict=True):
                entity.set_pose(sapien.Pose(t.astype(np.float32), q.astype(np.float32)))
        elif self._props_shown:
            for entity in self._props:
                entity.set_pose(_out_of_view())
        self._props_shown = Ts_camera_prop is not None
        T = _T_SAPIEN_CAMERA @ T_camera_object
        self._object.set_root_pose(sapien.Pose(T[:3, 3].astype(np.float32), se3.wxyz(T).astype(np.float32)))
        self._object.set_qpos(np.array([positions.get(name, 0.0) for name in self._joint_names], np.float32))
        self._turn_lamps(self._R_camera_world if T_camera_world is None else T_camera_world[:3, :3])
        self._scene.update_render()
        self._view.take_picture()

    def rgb(self) -> NDArray[np.uint8]:
        """(height, width, 3) colours of the last view, sRGB."""
        picture = self._view.get_picture("Color")
        return encode_srgb(picture[..., :3]) if self._linear else _to_bytes(picture)

    def colour_and_cover(self) -> NDArray[np.float32]:
        """(height, width, 4) of the last view, from the engine: colours, 0 to 1, and alpha, 1 where something is drawn.

        The colours are sRGB, but linear with the shader 'trivial'.
        """
        return np.asarray(self._view.get_picture("Color"))

    def linear_rgb(self) -> NDArray[np.float32]:
        """(height, width, 3) light of the last view, 0 to 1."""
        picture = self._view.get_picture("Color")[..., :3]
        return np.clip(picture, 0, 1) if self._linear else decode_srgb(picture)

    def materials(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Linear base colours (height, width, 3), 0 to 1, and specular strength (height, width) of the last view."""
        base = self._view.get_picture("Color" if self._linear else "Albedo")[..., :3]
        shape = self._view.get_picture("Segmentation")[..., 0]
        if self._strength is None:
            self._strength = _specular_strengths(self._scene, self._prop_gloss)
        return base, self._strength[np.minimum(shape, len(self._strength) - 1)]

    def depth_and_side(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Depth and side of the last view, as in `Picture`."""
        return _depth_and_side(self._view.get_picture("Position"), self._view.get_picture("Segmentation"), self._label)

    def _turn_lamps(self, R_camera_world: Array) -> None:
        """Rotate the lamps, which are fixed in the world, for a camera at `R_camera_world` (3, 3)."""
        import sapien

        R = R_camera_world @ self._R_camera_world.T
        if np.array_equal(R, self._R_now):
            return
        axes = _T_SAPIEN_CAMERA[:3, :3]
        turn = sapien.Pose(np.zeros(3, np.float32), se3.wxyz(axes @ R @ axes.T).astype(np.float32))
        for lamp, rest in zip(self._lamps, self._lamps_at_rest, strict=True):
            lamp.set_pose(turn * rest)
        self._R_now = R


def simulator() -> dict[str, str]:
    """Simulator, its version and the name of the render device, for a truth's `source`."""
    require_rendering()
    import sapien

    lines = sapien.render.get_device_summary().splitlines()
    device = next((line.split(":", 1)[1].strip() for line in lines if line.strip().startswith("GPU:")), "unknown")
    return {"simulator": "SAPIEN", "simulator_version": sapien.__version__, "render_device": device}


def encode_srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """sRGB bytes of linear light, 0 to 1 (IEC 61966-2-1), quantised to 65536 steps."""
    return _srgb_tables()[0][_to_16_bits(linear)]


def decode_srgb(colours: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light, 0 to 1, of sRGB colours, 0 to 1, quantised to 65536 steps."""
    return _srgb_tables()[1][_to_16_bits(colours)]


def _to_16_bits(values: NDArray[np.float32]) -> NDArray[np.uint16]:
    return (np.clip(values, 0, 1) * np.float32(65535) + np.float32(0.5)).astype(np.uint16)


@functools.cache
def _srgb_tables() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Tables of sRGB bytes by linear light, and of linear light by sRGB."""
    x = np.arange(65536) / 65535
    return srgb_bytes(x), srgb_decode(x).astype(np.float32)


def _to_bytes(colours: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The first three channels of colours, 0 to 1, as bytes."""
    scaled = cv2.convertScaleAbs(colours, alpha=255.0)
    return np.asarray(scaled if scaled.shape[2] == 3 else cv2.cvtColor(scaled, cv2.COLOR_RGBA2RGB), np.uint8)


_PROP = 255
"""Label of props."""


@numba.njit(cache=True)
def _depth_and_side(
    position: NDArray[np.float32], segmentation: NDArray[np.uint32], label: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth and side of the engine's pictures (h, w, 4); `label` by entity, its last entry for larger ids."""
    height, width = position.shape[:2]
    depth, side = np.zeros((height, width), np.float32), np.zeros((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            found = label[min(segmentation[v, u, 1], np.uint32(len(label) - 1))]
            if found > 0:
                depth[v, u] = -position[v, u, 2]
                side[v, u] = found if found != _PROP else 0
    return depth, side


def _render_body(skins: Sequence[Skin]) -> Any:
    """The engine's render body of a prop."""
    import sapien

    body = sapien.render.RenderBodyComponent()
    for skin in skins:
        pixels = np.dstack([skin.picture, np.full(skin.picture.shape[:2], 255, np.uint8)])
        material = sapien.render.RenderMaterial(roughness=skin.roughness, specular=0.3)
        material.base_color_texture = sapien.render.RenderTexture2D(pixels, "R8G8B8A8Unorm", srgb=True)
        shape = (skin.vertices, np.float32), (skin.faces, np.uint32), (skin.normals, np.float32), (skin.uv, np.float32)
        body.attach(sapien.render.RenderShapeTriangleMesh(*(x.astype(kind) for x, kind in shape), material))
    return body


def _out_of_view() -> Any:
    """A pose behind the camera, where a prop is not visible."""
    import sapien

    return sapien.Pose([-1e4, 0, 0])


def _load(scene: Any, urdf: Path, root: Path | None) -> Any:
    """The articulation of a URDF without collision shapes and without absent files."""
    read = read_urdf(urdf)
    loader = scene.create_urdf_loader()
    loader.fix_root_link = False
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place, sapien_urdf(urdf, root) as readable:
        own = urdf.name != URDF_NAME
        if own:
            joints = {n: replace(j, type="fixed") if j.type == FLOATING else j for n, j in read.joints.items()}
            bare = replace(read.with_shapes(lambda *_: None), joints=joints, mujoco={})
            readable = Path(place) / urdf.name
            readable.write_bytes(format_urdf(bare))
        try:
            builders = loader.parse(str(readable))[0]
            for link in builders[0].link_builders:
                link.collision_records = []
            articulation = builders[0].build(fix_root_link=False)
            read_files_now(articulation)
        except Exception as error:  # the loader raises Exception itself
            lines = str(error).replace(str(readable.parent), str(urdf.parent)).strip().splitlines()
            raise FreeArtError(f"SAPIEN cannot load {urdf}: {lines[0] if lines else type(error).__name__}") from error
    if own:
        shown = read_visuals(read, find_root(urdf, read_file_names(urdf), root), Gaps(set))
        for link in articulation.links:
            surfaces = [v.surface.moved(v.T_link_mesh, v.scale) for v in shown[link.name]]
            if surfaces:
                link.entity.add_component(_render_body([skin for s in surfaces for skin in _skins(s)]))
    return articulation


def _skins(surface: Surface) -> list[Skin]:
    """A skin for each paint of a surface, of the finish 'plastic'."""
    strength, exponent = SHINE["plastic"]
    normals = crease_normals(surface.vertices, surface.faces)
    skins = []
    for k, paint in enumerate(surface.paints):
        here = surface.paint[surface.faces[:, 0]] == k
        corners = surface.faces[here].reshape(-1)
        picture = plain(tuple((paint.colour / 255.0).tolist())) if paint.picture is None else paint.picture
        if len(corners):
            skins.append(
                Skin(
                    surface.vertices[corners],
                    np.arange(len(corners)).reshape(-1, 3),
                    normals[here].reshape(-1, 3),
                    surface.uv[corners],
                    picture,
                    1 - strength * float(np.sqrt(exponent / 1000)),
                )
            )
    return skins


def _specular_strengths(scene: Any, known: dict[int, list[float]]) -> NDArray[np.float32]:
    """Specular strength (MTL Ks) by per-scene id of a shape; the last entry is for background.

    `known` gives the strengths of all shapes of some entities, by the entity's per-scene id. Of other shapes SAPIEN's
    importer keeps only the roughness 1 - Ks sqrt(Ns / 1000); it is solved for Ks with the exponent Ns = 230 Ks, about
    that of `generator.model.SHINE`.
    """
    import sapien

    found = {0: 0.0}
    for entity in scene.entities:
        body = entity.find_component_by_type(sapien.render.RenderBodyComponent)
        shapes = body.render_shapes if body is not None else ()
        if entity.per_scene_id in known:
            found |= {s.per_scene_id: g for s, g in zip(shapes, known[entity.per_scene_id], strict=True)}
            continue
        for shape in shapes:
            roughness = np.mean([part.material.roughness for part in shape.parts])
            found[shape.per_scene_id] = float(np.clip((1 - roughness) / np.sqrt(0.23), 0, 1)) ** (2 / 3)
    table = np.zeros(max(found) + 2, np.float32)
    table[list(found)] = list(found.values())
    return table


def _group_labels(articulation: Any, groups: Sequence[Sequence[str]], urdf: Path) -> NDArray[np.uint8]:
    """Group label by per-scene entity id; the last entry is for larger ids, which are props."""
    ids = {link.name: link.entity.per_scene_id for link in articulation.links}
    labels = np.zeros(max(ids.values()) + 2, np.uint8)
    for label, names in enumerate(groups, start=1):
        for name in names:
            if name not in ids:
                raise FreeArtError(f"{urdf}: SAPIEN has no link '{name}'; links: {', '.join(ids)}")
            labels[ids[name]] = label
    labels[-1] = _PROP
    return labels
