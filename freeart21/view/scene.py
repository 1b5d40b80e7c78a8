"""The 3D view: a tree of links with a slider for every joint, and the surfaces on each link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from freeart21.view.document import Section, data_url, embed_array, embed_points
from freeart21.view.simplify import arrow, joined, simplified, turning_arrow
from freeart21.view.splats import SplatLayers, splat_data
from freeart21.view.video import encode_jpeg

MAX_FACES_PER_LAYER = 50_000
MAX_TEXTURE_SIDE = 1024


@dataclass(frozen=True)
class Slider:
    """One joint state that can be set on the page."""

    name: str
    type: Literal["revolute", "prismatic"]
    lower: float
    """Left end, rad or m."""
    upper: float
    """Right end, rad or m."""
    value: float
    """At first, rad or m."""
    states: NDArray[np.float64] | None = None
    """(n,) state in every frame of the video, for following the video."""


@dataclass(frozen=True)
class Link:
    """A rigid body of the scene."""

    parent: int
    """Index of an earlier link, or -1 for the world."""
    T_parent_link: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) parent from link at state zero."""
    joint: Joint | None = None
    """Its pose in the parent is `T_parent_link @ joint.transform(q)`: the axis is in the link's own frame."""
    slider: int = -1
    """Index of its slider: q = scale * slider + offset."""
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Layer:
    """Surfaces that are shown and hidden together; layers of one name have one entry in the legend."""

    name: str
    colour: str
    """'#rrggbb' of the legend mark, and of surfaces without colours of their own."""
    style: Literal["solid", "ghost", "axis"] = "solid"
    """A 'ghost' is transparent; an 'axis' is visible through solid surfaces."""
    shown: bool = True


@dataclass(frozen=True)
class Surface:
    """One mesh on a link."""

    mesh: Mesh
    """In the link's frame, metres."""
    link: int
    layer: int
    uv: NDArray[np.float64] | None = None
    """(V, 2) texture coordinates."""
    picture: NDArray[np.uint8] | None = None
    """(h, w, 3) RGB texture; the colours are sampled from it."""


@dataclass(frozen=True)
class Scene:
    """The content of the 3D view."""

    links: tuple[Link, ...]
    sliders: tuple[Slider, ...]
    layers: tuple[Layer, ...]
    surfaces: tuple[Surface, ...]
    up: Array
    """(3,) up in the world of the scene."""
    towards_viewer: Array
    """(3,) direction from the scene to the first viewpoint."""
    camera: Camera | None = None
    """The recording camera, as a second viewpoint."""
    Ts_camera_world: Array | None = None
    """(n, 4, 4) recording camera from the world of the scene, in every frame."""
    splats: SplatLayers | None = None
    """Gaussians in place of the surfaces of two layers."""
    focus: tuple[Array, float] | None = None
    """Centre (3,) and radius, m, of the ball that is visible at first; found from all solid surfaces when None."""


def link_poses(links: Sequence[Link], values: Sequence[float]) -> list[Array]:
    """(4, 4) world from link of every link, with the sliders at `values`; `Kinematics.linkPoses` does the same."""
    poses: list[Array] = []
    for link in links:
        T = (poses[link.parent] if link.parent >= 0 else np.eye(4)) @ link.T_parent_link
        if link.joint is not None:
            q = link.offset + (link.scale * values[link.slider] if link.slider >= 0 else 0.0)
            T = T @ link.joint.transform(q)
        poses.append(T)
    return poses


def axis_mesh(joint: Joint, near: ArrayLike, size: float, length: float = 1.15) -> Mesh:
    """An arrow along the axis, and round it a bent one for a revolute joint: both show positive motion.

    It is centred at the axis point nearest to `near` (3,), and `length` times `size` (m), the object's diagonal, long.
    """
    radius = 0.008 * size / length
    shape = arrow(length * size, radius)
    if joint.type == "revolute":
        shape = joined(shape, turning_arrow(0.085 * size, 0.7 * radius, 0.36 * length * size))
    return shape.moved(axis_pose(joint, near))


def axis_point(joint: Joint, near: ArrayLike) -> Array:
    """(3,) the axis point nearest to `near`; of a prismatic joint `near` itself, as its axis has no place."""
    near = np.asarray(near, float)
    return near if joint.type == "prismatic" else joint.pivot + joint.axis * (joint.axis @ (near - joint.pivot))


def axis_pose(joint: Joint, near: ArrayLike) -> Array:
    """(4, 4) with z along the axis and the origin at `axis_point`."""
    other = np.eye(3)[np.argmin(np.abs(joint.axis))]
    x = np.cross(other, joint.axis)
    x /= np.linalg.norm(x)
    return se3.pose(np.stack([x, np.cross(joint.axis, x), joint.axis], -1), axis_point(joint, near))


def slider_range(joint: Joint, states: ArrayLike | None = None, size: float = 1.0) -> tuple[float, float]:
    """Ends of a joint's slider, rad or m: its limits and all its states, else half a turn or `size` to both sides."""
    known = [] if states is None else [float(np.min(states)), float(np.max(states))]
    free = np.pi if joint.type == "revolute" else size
    ends = known + [limit for limit in (joint.lower, joint.upper) if np.isfinite(limit)]
    lower = min(ends) if np.isfinite(joint.lower) or known else -free
    upper = max(ends) if np.isfinite(joint.upper) or known else free
    return (lower, upper) if upper > lower else (lower - 0.1 * free, upper + 0.1 * free)


def without_outliers(points: ArrayLike) -> Array:
    """(m, 3) of points (n, 3), without the 1 % farthest from their median."""
    points = np.asarray(points, float)
    distances = np.linalg.norm(points - np.median(points, 0), axis=1)
    return np.asarray(points[distances <= np.quantile(distances, 0.99, method="higher")])


def scene_section(
    scene: Scene,
    title: str = "3D view",
    place: Literal["right", "full"] = "right",
    max_faces: int = MAX_FACES_PER_LAYER,
    note: str = "",
) -> Section:
    """The 3D view of a scene. Layers with more than `max_faces` triangles are simplified."""
    surfaces = [
        part
        for layer in range(len(scene.layers))
        for part in _reduced([s for s in scene.surfaces if s.layer == layer and not s.mesh.empty], max_faces)
    ]
    pictures = list({id(s.picture): s.picture for s in surfaces if s.picture is not None}.values())
    centre, radius = scene.focus or find_focus(scene)
    camera, splats = scene.camera, scene.splats
    data = {
        "links": [_link_data(link) for link in scene.links],
        "sliders": [dict(vars(slider)) for slider in scene.sliders],
        "layers": [dict(vars(layer)) for layer in scene.layers],
        "surfaces": [_surface_data(surface, pictures) for surface in surfaces],
        "textures": [_picture_url(picture) for picture in pictures],
        "up": scene.up,
        "towards_viewer": scene.towards_viewer,
        "centre": centre,
        "radius": radius,
        "camera": camera and {"K": camera.K, "width": camera.width, "height": camera.height},
        "gaussians": None if splats is None else splat_data(splats),
        "camera_poses": None if scene.Ts_camera_world is None else np.round(scene.Ts_camera_world[:, :3], 6),
    }
    if splats is not None and len(splats.gaussians) > splats.max_count:
        note += f" Shown: the {splats.max_count:,} largest of {len(splats.gaussians):,} Gaussians."
    return Section(title, "", "scene", data, place, note.strip())


def _reduced(surfaces: list[Surface], max_faces: int) -> list[Surface]:
    """The surfaces of one layer, joined by link and texture, with at most `max_faces` triangles in all.

    Colours stand for the texture of what is simplified, else the texture for colours.
    """
    groups: dict[tuple[int, int], list[Surface]] = {}
    for surface in surfaces:
        groups.setdefault((surface.link, id(surface.picture)), []).append(surface)
    total = sum(len(surface.mesh.faces) for surface in surfaces)
    reduced = []
    for (link, _), group in groups.items():
        mesh, picture = joined(*(surface.mesh for surface in group)), group[0].picture
        uv = None if picture is None else np.concatenate([s.uv for s in group if s.uv is not None])
        colours = [surface.mesh.colours for surface in group if surface.mesh.colours is not None]
        if len(colours) == len(group) and (picture is None or total > max_faces):
            mesh = Mesh(mesh.vertices, mesh.faces, np.concatenate(colours))
        if total > max_faces:
            mesh, picture, uv = simplified(mesh, max(4, max_faces * len(mesh.faces) // total)), None, None
        reduced.append(Surface(mesh, link, surfaces[0].layer, uv, picture))
    return reduced


def _picture_url(picture: NDArray[np.uint8]) -> str:
    scale = min(1.0, MAX_TEXTURE_SIDE / max(picture.shape[:2]))
    if scale < 1:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return data_url("image/jpeg", encode_jpeg(picture, 85))


def _link_data(link: Link) -> dict[str, Any]:
    joint = link.joint
    return {
        "parent": link.parent,
        "T": link.T_parent_link,
        "slider": link.slider,
        "scale": link.scale,
        "offset": link.offset,
        "joint": None if joint is None else {"type": joint.type, "axis": joint.axis, "pivot": joint.pivot},
    }


def _surface_data(surface: Surface, pictures: list[NDArray[np.uint8]]) -> dict[str, Any]:
    mesh = surface.mesh
    return {
        "link": surface.link,
        "layer": surface.layer,
        "vertices": embed_points(mesh.vertices),
        "faces": embed_array(mesh.faces, "u16" if len(mesh.vertices) <= 1 << 16 else "u32"),
        "colours": None if mesh.colours is None else embed_array(mesh.colours, "u8"),
        "uv": None if surface.uv is None else embed_points(surface.uv),
        "texture": next((k for k, picture in enumerate(pictures) if picture is surface.picture), -1),
    }


def find_focus(scene: Scene) -> tuple[Array, float]:
    """Centre (3,) and radius, m, of the ball that is visible at first.

    It contains all solid surfaces with the sliders at their first values, and nearly all at the sliders' ends; without
    surfaces, the Gaussians except outliers.
    """
    solid = [s for s in scene.surfaces if scene.layers[s.layer].style == "solid" and not s.mesh.empty]
    shapes = [(s.link, s.mesh.vertices[s.mesh.faces[:, 0]]) for s in solid]
    if not shapes and scene.splats is not None:
        shapes = [(link, without_outliers(scene.splats.gaussians.means)) for link in set(scene.splats.links)]
    if not shapes:
        return np.zeros(3), 1.0

    def points(values: list[float]) -> Array:
        poses = link_poses(scene.links, values)
        return np.concatenate([se3.transform(poses[link], vertices) for link, vertices in shapes])

    first = points([s.value for s in scene.sliders])
    centre = (first.min(0) + first.max(0)) / 2
    ends = [[s.lower for s in scene.sliders], [s.upper for s in scene.sliders]]
    radius, *reach = (float(np.linalg.norm(p - centre, axis=1).max()) for p in (first, *map(points, ends)))
    return centre, max(radius, 0.92 * max(reach), 1e-6)
