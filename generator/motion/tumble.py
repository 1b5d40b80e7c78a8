"""The tumbling motion: an object held before the camera, turned this way and that while its joint is worked."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from generator.motion.plan import Plan
from generator.rays import Caster

Hulls = tuple[Array, Array]
"""Points (k, 3) that bound each side of an object."""


@dataclass(frozen=True)
class MotionSettings:
    """How an object is tumbled."""

    degrees_per_frame: float = 2.5
    """Median turn from frame to frame."""
    swings: int = 3
    """Sinusoids per axis of rotation and translation."""
    yaw_degrees: float = 80.0
    """How far it turns about its upright axis, to either side; the other two axes turn half as far."""
    lowest_hz: float = 0.6
    """Slowest sinusoid, relative to the others: frequencies lie between this and 1, then all are scaled together."""
    fill: float = 0.6
    """Mean height of the object in the picture, as a share of the picture's height."""
    margin: float = 0.02
    """Strip along the picture's border, as a share of its height, that the object never enters."""
    drift: tuple[float, float, float] = (0.05, 0.02, 0.05)
    """Size of the translation (right, down, away), as shares of the distance to the object."""
    candidates: int = 6
    """Tumbles drawn, of which the one that shows both parts best is taken."""


def plan_tumble(
    meshes: tuple[Mesh, Mesh],
    joint: Joint,
    camera: Camera,
    frames: int,
    fps: float,
    seed: int,
    settings: MotionSettings | None = None,
) -> Plan:
    """A tumble of the two sides (`joint` moves the second) that keeps the whole object in the picture.

    Poses and states are smooth (two continuous derivatives) and drawn independently; the joint runs over its full
    range, there and back, with pauses. Everything follows from the seed.
    """
    settings = settings or MotionSettings()
    rng_joint, rng_pose = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2])
    lower, upper = motion_range(joint)
    states = lower + (upper - lower) * joint_course(frames, rng_joint)
    hulls = hull_points(meshes[0]), hull_points(meshes[1])
    swept = np.concatenate(
        [hulls[0], *(se3.transform(joint.transform(q), hulls[1]) for q in np.linspace(lower, upper, 5))]
    )
    centre = (swept.min(0) + swept.max(0)) / 2
    caster = Caster(meshes)
    best: tuple[float, Array] | None = None
    for _ in range(settings.candidates):
        base = _best_view(caster, joint, float(states[0]), centre, swept, rng_pose)
        turns, sway = _tumble(frames, fps, rng_pose, settings)
        Rs = turns @ base
        Ts = _placed(Rs, sway, centre, hulls, joint, states, camera, settings)
        score = _shown(caster, joint, Ts, states, camera)
        if best is None or score > best[0]:
            best = score, Ts
    assert best is not None
    camera_world = se3.pose(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), best[1][0, :3, 3])
    return Plan(best[1], states, np.broadcast_to(camera_world, best[1].shape).copy())


def motion_range(joint: Joint) -> tuple[float, float]:
    """The states to run over: the limits, or half a turn to either side (one metre) where there is none."""
    free = np.pi if joint.type == "revolute" else 1.0
    return (
        joint.lower if np.isfinite(joint.lower) else min(-free, joint.upper - 2 * free),
        joint.upper if np.isfinite(joint.upper) else max(free, joint.lower + 2 * free),
    )


def joint_course(frames: int, rng: np.random.Generator) -> Array:
    """Share of the range (frames,) over time: part open, then all the way open, shut and open again, with pauses.

    Recordings of more than 200 frames go on with moves to random places. Moves are quintic smoothsteps, so velocity and
    acceleration vanish at their ends.
    """
    stops = [rng.uniform(0.12, 0.3), 1.0, 0.0, 1.0]
    while len(stops) < frames // 60:
        stops.append(float(rng.uniform(0.0, 0.5) if stops[-1] > 0.5 else rng.uniform(0.5, 1.0)))
    moves = np.abs(np.diff(stops)) * rng.uniform(0.9, 1.2, len(stops) - 1)
    pauses = rng.uniform(0.06, 0.16, len(stops))
    knots = np.cumsum(np.concatenate([[0.0], np.stack([pauses[:-1], moves], 1).reshape(-1), pauses[-1:]]))
    t = np.linspace(0, knots[-1], frames) if frames > 1 else np.zeros(1)
    course = np.full(frames, stops[0])
    for k, (a, b) in enumerate(itertools.pairwise(stops)):
        u = np.clip((t - knots[2 * k + 1]) / (knots[2 * k + 2] - knots[2 * k + 1]), 0, 1)
        course += (b - a) * u**3 * (10 - 15 * u + 6 * u**2)
    return np.clip(course, 0.0, 1.0)


def _tumble(frames: int, fps: float, rng: np.random.Generator, settings: MotionSettings) -> tuple[Array, Array]:
    """Turns (frames, 3, 3), the identity in frame 0, and sways (frames, 3) in -1 to 1, at the wanted median speed."""
    phases, rates = (
        rng.uniform(0, 2 * np.pi, (2, 3, settings.swings)),
        rng.uniform(settings.lowest_hz, 1, (2, 3, settings.swings)),
    )
    weights = rng.uniform(0.5, 1.0, (2, 3, settings.swings))
    weights /= weights.sum(-1, keepdims=True)
    reach = np.radians(settings.yaw_degrees) * np.array([0.5, 1.0, 0.5])

    def course(scale: float) -> tuple[Array, Array]:
        t = np.arange(frames)[:, None, None, None] / fps * scale
        swing = (weights * np.sin(2 * np.pi * rates * t + phases)).sum(-1)
        angles = swing[:, 0] * reach * 2.2  # weights add up to 1, but sinusoids seldom peak together
        Rs = (
            se3.exp_so3(angles[:, 1:2] * [0, 1, 0])
            @ se3.exp_so3(angles[:, 0:1] * [1, 0, 0])
            @ se3.exp_so3(angles[:, 2:3] * [0, 0, 1])
        )
        return Rs @ Rs[0].T, swing[:, 1]

    # Which stretch of the course is run, and so the median, changes with the scale: the steps towards it are halved.
    wanted, scale, best = np.radians(settings.degrees_per_frame), 0.3, (np.inf, course(0.3))
    for _ in range(30):
        Rs, sway = course(scale)
        median = float(np.median(se3.rotation_angle(Rs[1:] @ np.swapaxes(Rs[:-1], -1, -2))))
        if abs(np.log(median / wanted)) < best[0]:
            best = float(abs(np.log(median / wanted))), (Rs, sway)
        scale = float(np.clip(scale * np.sqrt(wanted / median), 0.02, 2.0))
    return best[1]


def _best_view(caster: Caster, joint: Joint, q: float, centre: Array, swept: Array, rng: np.random.Generator) -> Array:
    """The rotation (3, 3), object upright, of some twenty drawn, that shows most of the part that shows less."""
    camera = Camera.from_fov(64, 48, 0.5)
    distance = 2.2 * np.linalg.norm(swept - centre, axis=1).max() / np.tan(0.25)
    best, best_share = np.eye(3), -1.0
    for yaw, pitch in zip(rng.uniform(-np.pi, np.pi, 20), rng.uniform(-0.5, 0.9, 20), strict=True):
        # z up to y down, then yaw about the upright axis and a look from above or below
        upright = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
        R = se3.exp_so3(np.array([pitch, 0, 0])) @ upright @ se3.exp_so3(np.array([0, 0, yaw]))
        T = se3.pose(R, np.array([0, 0, distance]) - R @ centre)
        counts = _counts(caster, joint, T, q, camera)
        share = float(counts.min() / max(counts.sum(), 1))
        if share > best_share:
            best, best_share = R, share
    return best


def _counts(caster: Caster, joint: Joint, T_camera_object: Array, q: float, camera: Camera) -> Array:
    """(2,) pixels of each side of the object."""
    side = caster.look(camera, (T_camera_object, T_camera_object @ joint.transform(q))).side
    return np.array([np.sum(side == 0), np.sum(side == 1)])


def _shown(caster: Caster, joint: Joint, Ts: Array, states: Array, camera: Camera) -> float:
    """How well a motion shows both parts.

    The smaller part's share of the object's pixels, capped at 20 %, as the mean over frames and, as much again, in the
    first; and twice the share of the picture that the object fills.
    """
    small = Camera(np.diag([1 / 8, 1 / 8, 1.0]) @ camera.K, max(camera.width // 8, 1), max(camera.height // 8, 1))
    some = np.unique(np.linspace(0, len(states) - 1, 16).astype(int))
    counts = np.array([_counts(caster, joint, Ts[i], float(states[i]), small) for i in some])
    shares = np.minimum(counts.min(1) / np.maximum(counts.sum(1), 1), 0.2)
    return float(shares.mean() + shares[0] + 2 * counts.sum(1).mean() / (small.width * small.height))


def _placed(
    Rs: Array,
    sway: Array,
    centre: Array,
    hulls: Hulls,
    joint: Joint,
    states: Array,
    camera: Camera,
    settings: MotionSettings,
) -> Array:
    """Poses (n, 4, 4) at the nearest distance that fills the picture as wanted and keeps the object inside it."""
    radius = max(np.linalg.norm(h - centre, axis=1).max() for h in hulls)
    near, far = 1.2 * radius, 400 * radius
    for _ in range(16):
        distance = np.sqrt(near * far)
        low, high, height = _extent(_at(Rs, sway, centre, distance, settings), hulls, joint, states, camera)
        strip = settings.margin * camera.height
        inside = (low >= strip).all() and (high <= np.array([camera.width, camera.height]) - strip).all()
        if inside and height <= settings.fill * camera.height:
            far = distance
        else:
            near = distance
    return _at(Rs, sway, centre, far, settings)


def _at(Rs: Array, sway: Array, centre: Array, distance: float, settings: MotionSettings) -> Array:
    t = np.array([0, 0, distance]) + np.array(settings.drift) * distance * sway - Rs @ centre
    return se3.pose(Rs, t)


def _extent(Ts: Array, hulls: Hulls, joint: Joint, states: Array, camera: Camera) -> tuple[Array, Array, float]:
    """Lowest and highest image coordinates (n, 2) of the object in every frame, and its mean height, pixels."""
    points = np.concatenate(
        [se3.transform(Ts, hulls[0]), se3.transform(Ts @ joint.transform(states), hulls[1])], axis=1
    )
    if (points[..., 2] <= 0).any():
        return np.full((1, 2), -np.inf), np.full((1, 2), np.inf), np.inf
    uv = camera.project(points)
    low, high = uv.min(1), uv.max(1)
    return low, high, float((high - low)[:, 1].mean())


def hull_points(mesh: Mesh) -> Array:
    """The corners of the convex hull of a mesh: what bounds it in every view."""
    points = mesh.vertices[np.unique(mesh.faces)]
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # a flat part has no hull of its own
        return points
