"""Small synthetic clips of two-body objects, ray-cast with Embree: for tests that must not need a simulator."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.ndimage import map_coordinates

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.recording import Frame, Query, Recording


@dataclass(frozen=True)
class Clip:
    """A recording and its answer, which only the test may look at."""

    recording: Recording
    joint: Joint
    states: np.ndarray
    Ts: np.ndarray
    part_masks: np.ndarray
    diagonal: float


def box(size, centre):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(centre)
    return mesh


OBJECTS = {
    "hinge": (
        [box((0.30, 0.10, 0.03), (0, 0, 0)), box((0.03, 0.12, 0.08), (-0.14, 0, 0.03))],
        [box((0.28, 0.09, 0.03), (0.02, 0, 0.06)), box((0.04, 0.05, 0.03), (0.14, 0.01, 0.09))],
        Joint("j", "revolute", np.array([0.0, -1, 0]), np.array([-0.13, 0, 0.05]), 0, 1.2),
        (0.05, 0.8),
    ),
    "slide": (
        [box((0.20, 0.26, 0.03), (0, 0, 0.09)), box((0.20, 0.26, 0.03), (0, 0, -0.09))]
        + [box((0.20, 0.03, 0.18), (0, y, 0)) for y in (-0.115, 0.115)]
        + [box((0.03, 0.26, 0.20), (-0.09, 0, 0))],
        [box((0.19, 0.19, 0.12), (0.01, 0, 0)), box((0.03, 0.06, 0.03), (0.12, 0.02, 0.01))],
        Joint("j", "prismatic", np.array([1.0, 0, 0]), np.zeros(3), 0, 0.15),
        (0.0, 0.14),
    ),
    "handle": (  # a part that moves, on 2 % of the pixels
        [box((0.30, 0.20, 0.06), (0, 0, 0))],
        [box((0.05, 0.012, 0.02), (0.02, 0, 0.04))],
        Joint("j", "revolute", np.array([0.0, 0, 1]), np.zeros(3), 0, 1.2),
        (0.0, 1.2),
    ),
    "rigid": (
        [box((0.30, 0.10, 0.03), (0, 0, 0)), box((0.03, 0.12, 0.08), (-0.14, 0, 0.03))],
        [box((0.28, 0.09, 0.03), (0.02, 0, 0.06))],
        Joint("j", "revolute", np.array([0.0, -1, 0]), np.array([-0.13, 0, 0.05]), 0, 1.2),
        (0.3, 0.3),
    ),
}


def make_clip(name="hinge", frames=24, size=(240, 180), seed=0, scale=1.0, spin=1.2, queries=(), sweep=None):
    """A clip of an object tumbling `spin` radians or so while its joint sweeps its range; `scale` makes all larger.

    `sweep` (frames,) is the position in the range of the joint, from 0 to 1.
    """
    first, second, joint, (low, high) = OBJECTS[name]
    first, second = trimesh.util.concatenate(first), trimesh.util.concatenate(second)
    rng = np.random.default_rng(seed)
    camera = Camera.from_fov(*size, np.radians(22))
    t = np.linspace(0, 1, frames)
    phase = rng.uniform(0, 2 * np.pi, 3)
    turn = spin * np.stack([np.sin(2 * np.pi * 0.55 * t + p) for p in phase], 1)
    base = se3.exp_so3([0.5, 0.4, 0.1]) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from the side, a bit above
    Ts = se3.pose(
        se3.exp_so3(turn) @ base, np.stack([0.02 * np.sin(5 * t), 0.02 + 0.02 * np.cos(4 * t), 1.25 + 0 * t], 1)
    )
    sweep = 0.5 - 0.5 * np.cos(2 * np.pi * 0.8 * t) if sweep is None else np.asarray(sweep)
    states = low + (high - low) * sweep
    texture = rng.uniform(0.25, 1, (3, 12, 12, 12))
    pictures = [_render(camera, (first, second), joint, T, q, texture) for T, q in zip(Ts, states, strict=False)]
    loaded = [Frame(rgb, (depth * scale).astype(np.float32), part > 0) for rgb, depth, part in pictures]
    views = tuple(Query(*q) for q in queries)
    recording = Recording(camera, np.arange(frames) / 30, lambda i: loaded[i], views, None, name)
    scaled = Joint(joint.name, joint.type, joint.axis, joint.pivot * scale, joint.lower, joint.upper)
    Ts_scaled = Ts.copy()
    Ts_scaled[:, :3, 3] *= scale
    diagonal = float(np.linalg.norm(np.ptp(np.concatenate([first.vertices, second.vertices]), axis=0))) * scale
    factor = scale if joint.type == "prismatic" else 1
    return Clip(recording, scaled, states * factor, Ts_scaled, np.stack([p for _, _, p in pictures]), diagonal)


def _render(camera, parts, joint, T, q, texture):
    """rgb, depth and part labels of one frame."""
    poses = (T, T @ joint.transform(q))
    placed = [part.copy().apply_transform(pose) for part, pose in zip(parts, poses, strict=False)]
    scene = trimesh.util.concatenate(placed)
    rays = camera.rays().reshape(-1, 3)
    caster = trimesh.ray.ray_pyembree.RayMeshIntersector(scene)
    hit, ray, triangle = caster.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
    shape = (camera.height, camera.width)
    rgb, depth, part = np.full((*shape, 3), 255, np.uint8), np.zeros(shape), np.zeros(shape, np.uint8)
    label = 1 + (triangle >= len(parts[0].faces))
    rows, columns = np.divmod(ray, camera.width)
    colours = np.zeros((len(ray), 3))
    for k in (1, 2):
        mine = label == k
        body = se3.transform(se3.inverse(poses[k - 1]), hit[mine])
        at = (body / 0.05 % 12).T
        colours[mine] = np.stack([map_coordinates(c, at, order=1, mode="wrap") for c in texture], 1)
        colours[mine] *= (0.9, 0.75, 0.6) if k == 1 else (0.6, 0.8, 0.95)
    light = np.clip(scene.face_normals[triangle] @ np.array([0.3, -0.5, -0.81]), 0, 1)
    rgb[rows, columns] = np.clip(255 * colours * (0.45 + 0.55 * light[:, None]), 0, 255)
    depth[rows, columns], part[rows, columns] = hit[:, 2], label
    return rgb, depth, part
