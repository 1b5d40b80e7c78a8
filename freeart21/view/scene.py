"""The 3D view: a tree of links with a slider for every joint, surfaces on each link, and Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.gaussians import FAINT_COPY, TURNED_AWAY, Gaussians
from freeart21.joint import Joint
from freeart21.mesh import Mesh, join_meshes
from freeart21.se3 import Array
from freeart21.view.document import Section, embed_array, embed_points
from freeart21.view.link_shapes import of_trimesh
from freeart21.view.source import LAYERS, Source, axis_point
from freeart21.view.video import jpeg_url

MAX_FACES_PER_LAYER = 50_000
MAX_TEXTURE_SIDE = 1024
MAX_GAUSSIANS, MAX_GAUSSIANS_ALONE = 80_000, 350_000
"""In a page, 3 MB; in one of nothing else, 14 MB. From 500,000 on textures exceed what WebGL 2 guarantees."""
FIRST_VIEW = np.array([0.45, -0.4, -1.0])
"""Direction to the first viewpoint in a recording camera's frame (x right, y down, z away from the camera)."""


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

    links: Sequence[Link]
    sliders: Sequence[Slider]
    layers: Sequence[Layer]
    surfaces: Sequence[Surface]
    camera: Camera | None = None
    """The recording camera, as a second viewpoint."""
    Ts_camera_world: Array | None = None
    """(n, 4, 4) recording camera from the world of the scene, in every frame; the world's z is up when None."""
    gaussians: Gaussians | None = None
    """In place of the surfaces of the first two layers (or the only one), in the frame of the first two links."""
    focus: tuple[Array, float] | None = None
    """Centre (3,) and radius, m, of the ball that is visible at first; found from all solid surfaces when None."""


def sources_scene(sources: Sequence[Source], camera: Camera | None = None, gaussians: Gaussians | None = None) -> Scene:
    """Two parts and the joint axis of every source, in the first one's frame, moved by one slider.

    The slider can follow the states of the video. Sources with another joint type get sliders of their own. `gaussians`
    are the first source's.
    """
    poses = sources[0].Ts_camera if len(sources[0].Ts_camera) else np.eye(4)[None]
    scene = Scene([], [], [], [], camera, poses, gaussians)
    for source in sources:
        if source.articulation is None:
            continue
        joint, (near, size), root = source.joint, source.place(), len(scene.links)
        follows = bool(scene.sliders) and source.offset is not None
        moving = Link(root, joint=joint, slider=0, scale=source.sign, offset=source.offset or 0.0)
        if not follows:
            name, states = f"{source.name}: {joint.type}" if scene.sliders else joint.name, source.states
            ends = slider_range(joint, states, size)
            sliders = [*scene.sliders, Slider(name, joint.type, *ends, float(states[0]), states)]
            moving, scene = Link(root, joint=joint, slider=len(sliders) - 1), replace(scene, sliders=sliders)
        names = source.layers or (source.name,) * 3
        colours, first = (*source.colours, source.axis_colour or source.colours[1]), len(scene.layers)
        layers = [
            *(Layer(names[k], colours[k], "ghost" if source.ghost else "solid", source.shown) for k in (0, 1)),
            Layer(names[2], colours[2], "axis", source.shown or source.ghost),
        ]
        meshes = [source.articulation.reference, source.articulation.moving, axis_mesh(joint, near, size)]
        surfaces = []
        for k, mesh in enumerate(meshes):  # of one colour, or a ghost: a mesh has its part's colour
            plain = source.ghost or (mesh.colours is not None and (mesh.colours == mesh.colours[:1]).all())
            surfaces.append(Surface(replace(mesh, colours=None) if plain else mesh, root + (k == 1), first + k))
        scene = replace(
            scene,
            links=[*scene.links, Link(-1), moving],
            layers=[*scene.layers, *layers],
            surfaces=[*scene.surfaces, *surfaces],
        )
        scene = replace(scene, focus=scene.focus or find_focus(scene))
    return scene


def gaussians_scene(gaussians: Gaussians) -> Scene:
    """Gaussians alone, y down and z away from the viewer as in the first camera of a video."""
    names = LAYERS[:2] if (gaussians.part_weights < 1).any() else ("Gaussians",)
    layers = [Layer(name, colour) for name, colour in zip(names, Source("").colours, strict=False)]
    return Scene([Link(-1), Link(-1)], [], layers, [], None, np.eye(4)[None], gaussians)


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


def axis_mesh(joint: Joint, near: ArrayLike, size: float) -> Mesh:
    """An arrow along the axis, and round it a bent one for a revolute joint: both show positive motion.

    It is centred at the axis point nearest to `near` (3,), and 1.15 times `size` (m), the object's diagonal, long.
    """
    from trimesh.creation import cone, revolve

    r = 0.007 / 1.15
    arrow = [(0, -0.5), (r, -0.5), (r, 0.5 - 5 * r), (2.4 * r, 0.5 - 5 * r), (0, 0.5)]
    shape = of_trimesh(revolve(arrow), 1.15 * size)
    if joint.type == "revolute":
        ring, radius, height = 0.085 * size, 0.005 * size, 0.41 * size
        around = np.linspace(0, 2 * np.pi, 13)
        circle = np.stack([ring + radius * np.cos(around), height + radius * np.sin(around)], -1)
        tail = of_trimesh(revolve(circle / ring, angle=1.5 * np.pi, sections=48), ring)
        along_x = se3.pose(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), [0, -ring, height])
        shape = join_meshes([shape, tail, of_trimesh(cone(2.4, 5), radius).moved(along_x)])
    x = np.cross(np.eye(3)[np.argmin(np.abs(joint.axis))], joint.axis)
    x /= np.linalg.norm(x)
    return shape.moved(se3.pose(np.stack([x, np.cross(joint.axis, x), joint.axis], -1), axis_point(joint, near)))


def slider_range(joint: Joint, states: ArrayLike, size: float = 1.0) -> tuple[float, float]:
    """Ends of a joint's slider, rad or m: its limits and all states (n,)."""
    ends = [float(q) for q in (np.min(states), np.max(states), joint.lower, joint.upper) if np.isfinite(q)]
    free = np.pi if joint.type == "revolute" else size
    lower, upper = min(ends), max(ends)
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
    poses, up, towards = scene.Ts_camera_world, np.array([0.0, 0.0, 1.0]), np.array([-1.0, -0.75, 0.55])
    if poses is not None:
        up, towards = poses[0, :3, :3].T @ [0.0, -1.0, 0.0], poses[0, :3, :3].T @ FIRST_VIEW
    data = {
        "links": scene.links,
        "sliders": scene.sliders,
        "layers": scene.layers,
        "surfaces": [_surface_data(surface, pictures) for surface in surfaces],
        "textures": [_picture_url(picture) for picture in pictures],
        "up": up,
        "towards_viewer": towards,
        "centre": centre,
        "radius": radius,
        "camera": scene.camera,
        "gaussians": None,
        "camera_poses": None if poses is None else np.round(poses[:, :3], 6),
    }
    if scene.gaussians is not None:
        most, n = MAX_GAUSSIANS if scene.surfaces else MAX_GAUSSIANS_ALONE, len(scene.gaussians)
        data["gaussians"] = _gaussians_data(scene.gaussians, most, len(scene.layers))
        note += f" Shown: the {most:,} largest of {n:,} Gaussians." if n > most else ""
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
        mesh, picture = join_meshes([surface.mesh for surface in group]), group[0].picture
        if total > max_faces:
            mesh, picture = simplified(mesh, max(4, max_faces * len(mesh.faces) // total)), None
        elif picture is not None:
            mesh = replace(mesh, colours=None)
        uv = None if picture is None else np.concatenate([s.uv for s in group if s.uv is not None])
        reduced.append(Surface(mesh, link, surfaces[0].layer, uv, picture))
    return reduced


def simplified(mesh: Mesh, max_faces: int) -> Mesh:
    """`mesh` with at most `max_faces` triangles, for display only.

    By quadric errors (Garland and Heckbert 1997); where many small pieces keep it above, the largest triangles stay. A
    vertex gets the colour of the nearest one.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    from fast_simplification import simplify
    from scipy.spatial import cKDTree

    used, faces = np.unique(mesh.faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    points = mesh.vertices[used].astype(np.float32)
    vertices, faces = simplify(points, faces.astype(np.int32), target_count=max_faces, agg=7.0)
    if len(faces) > max_faces:
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        faces = faces[np.sort(np.argsort(-area, kind="stable")[:max_faces])]
    colours = None if mesh.colours is None else mesh.colours[used[cKDTree(points).query(vertices)[1]]]
    return Mesh(vertices.astype(float), faces.astype(np.int64), colours)


def _picture_url(picture: NDArray[np.uint8]) -> str:
    scale = min(1.0, MAX_TEXTURE_SIDE / max(picture.shape[:2]))
    if scale < 1:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return jpeg_url(picture, 85)


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


def _gaussians_data(gaussians: Gaussians, most: int, layers: int) -> dict[str, Any]:
    """The `most` Gaussians with the largest opacity times area of the largest section, 27 to 30 bytes each.

    Scales are logarithms between the smallest and the largest, 8 bits; of quaternions and normals, 127 is 1.
    """
    if len(gaussians) > most:
        widths = np.sort(gaussians.scales.astype(float), 1)
        cover = gaussians.opacities * widths[:, 1] * widths[:, 2]
        gaussians = gaussians.chosen(np.sort(np.argsort(-cover, kind="stable")[:most]))
    logs = np.log(np.maximum(gaussians.scales.astype(float), 1e-9))
    least, largest = (float(logs.min()), float(logs.max())) if len(logs) else (0.0, 0.0)
    return {
        "links": [0, 1],
        "layers": [0, min(1, layers - 1)],
        "scales_between": [least, largest],
        "means": embed_array(gaussians.means, "f32"),
        "scales": embed_array(np.rint((logs - least) / max(largest - least, 1e-9) * 255), "u8"),
        "quaternions": embed_array(np.rint(gaussians.quaternions * 127 + 128), "u8"),
        "colours": embed_array(np.rint(gaussians.colours.clip(0, 1) * 255), "u8"),
        "opacities": embed_array(np.rint(gaussians.opacities.clip(0, 1) * 255), "u8"),
        "light": gaussians.light,
        "normals": None if gaussians.light is None else embed_array(np.rint(gaussians.normals * 127 + 128), "u8"),
        "turned_away": TURNED_AWAY,
        "faint_copy": FAINT_COPY,
        "part_weights": embed_array(np.rint(gaussians.part_weights.clip(0, 1) * 255), "u8"),
    }


def find_focus(scene: Scene) -> tuple[Array, float]:
    """Centre (3,) and radius, m, of the ball that is visible at first.

    It contains all solid surfaces with the sliders at their first values, and nearly all at the sliders' ends; without
    surfaces, the Gaussians except outliers.
    """
    solid = [s for s in scene.surfaces if scene.layers[s.layer].style == "solid" and not s.mesh.empty]
    shapes = [(s.link, s.mesh.vertices[s.mesh.faces[:, 0]]) for s in solid]
    if not shapes and scene.gaussians is not None:
        shapes = [(link, without_outliers(scene.gaussians.means)) for link in (0, 1)]
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
