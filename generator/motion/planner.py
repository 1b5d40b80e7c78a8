"""Plans a motion: draws candidates of a style, scores them by a visibility table, and recounts the best ones."""

from __future__ import annotations

import zlib
from dataclasses import replace

import numpy as np

from freeart21 import se3, sphere
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.se3 import Array
from freeart21.statistics import longest_run
from generator.motion import turns
from generator.motion.body import UPRIGHT, Body
from generator.motion.framing import place_object
from generator.motion.plan import PRESETS, Plan, Preset
from generator.motion.style import Course, Hardship, Style, Task
from generator.motion.styles import STYLES
from generator.motion.visibility import Atlas

FEW = 0.05
"""A part with a smaller share of the object's pixels is hard to follow."""
_HARD_SHARE = (0.19, 0.32)  # share of frames in which a hard motion shows fewer
_GONE_FRAMES = (9, 40)
_HARD, _GONE = 0.5, 0.4  # share of seeds that are hard where possible, and of these those that hide a side fully
_HIDEABLE = 0.008  # least share of directions that hide a side, for its motions to be hard at all
_COUNTED = 4


def plan_motion(
    style_name: str,
    meshes: tuple[Mesh, Mesh],
    joint: Joint,
    camera: Camera,
    frames: int,
    fps: float,
    seed: int,
    preset: Preset = PRESETS["handheld"],
    states: Array | None = None,
    hard: bool | None = None,
) -> Plan:
    """Plan `frames` poses and joint states of an object in a style; everything follows from the seed.

    About a third of all (object, seed) are hard: the smaller side shows less than 5 % of the object's pixels in 19 to
    32 % of the frames; in some of these it is out of sight for a while. Frame 0 shows both sides. Where no view of an
    object hides a side, the motion hides it as far as possible.

    Args:
        style_name: one of `STYLES`.
        meshes: the sides of the joint, parent and child, in the object's frame (z up), of the preset's size.
        joint: what moves the second mesh.
        camera: intrinsics; the object stays inside its picture.
        frames: 2 or more.
        fps: frames a second.
        seed: of all random numbers.
        preset: size and distance.
        states: (frames,) given joint states, rad or m, instead of planned ones; 'release' needs them.
        hard: whether the smaller side is hidden for long; None decides by object and seed.

    Raises FreeArtError for an unknown style and for states that do not fit.
    """
    if style_name not in STYLES:
        raise FreeArtError(f"unknown motion '{style_name}'; motions: {', '.join(STYLES)}")
    style = STYLES[style_name]
    if frames < 2 or fps <= 0:
        raise FreeArtError(f"cannot plan {frames} frames at {fps:g} a second; expected 2 or more, above 0 a second")
    if states is None and style.plan is not None:
        raise FreeArtError(f"motion '{style_name}' needs the joint's states, rolled out by generator.release")
    if states is not None:
        states = np.asarray(states, float)
        if states.shape != (frames,) or not np.isfinite(states).all():
            raise FreeArtError(f"given states have shape {states.shape}, expected {frames} finite numbers")
    body = Body.of(meshes, joint)
    if style.propose is None:
        assert style.plan is not None and states is not None
        return style.plan(body, states, camera, preset, seed)
    distance = body.radius * max(1.1 * camera.K[1, 1] / (0.5 * camera.height), 1.6)
    atlas = Atlas(body, distance) if frames >= 60 else Atlas(body, distance, 96, 4)
    task = Task(body, atlas, frames, fps, "hidden", states, style.heights, (seed, _shape_key(body)))
    task = replace(task, hardship=_draw_hardship(task, seed, hard))
    rng = np.random.default_rng([seed, 2, style.stream, _shape_key(body)])
    drawn = int(np.clip(frames // 8, 6, 20 if task.hardship == "none" else 36))
    candidates = [style.propose(task, rng) for _ in range(drawn)]
    guessed = [_score(c, task, task.atlas.shares(_view_directions(c.Rs), c.states)) for c in candidates]
    best: tuple[float, Plan] | None = None
    for k in sorted(range(len(candidates)), key=lambda k: -guessed[k])[:_COUNTED]:
        course = candidates[k]
        Ts = place_object(course.Rs, course.offsets, course.clock, course.states, body, camera, preset, style.still)
        score = _score(course, task, task.atlas.count_shares(Ts, course.states))
        if best is None or score > best[0]:
            best = score, Plan(Ts, course.states, camera_in_world(style, Ts, body))
    assert best is not None
    return best[1]


def _draw_hardship(task: Task, seed: int, hard: bool | None) -> Hardship:
    """Draw the hardship from object and seed; objects whose sides are always visible are never hard."""
    luck, kind = np.random.default_rng([seed, 7, _shape_key(task.body)]).uniform(0, 1, 2)
    if hard is None:
        hard = bool(luck < _HARD and task.hidden_area().max() > _HIDEABLE)
    if not hard:
        return "none"
    gone = replace(task, hardship="gone").hidden_area().max() > _HIDEABLE
    return "gone" if gone and kind < _GONE else "hidden"


def _shape_key(body: Body) -> int:
    """A hash of the object's proportions: objects with the same seed move differently."""
    extents = np.concatenate([np.ptp(h, axis=0) for h in body.hulls]) / body.radius
    return zlib.crc32(" ".join(f"{x:.3f}" for x in extents).encode())


def _view_directions(Rs: Array) -> Array:
    """(n, 3) directions from the object to the camera."""
    return -Rs[:, 2]


def _score(course: Course, task: Task, shares: Array) -> float:
    """Score of a candidate, rounded so that the last digits, which differ between machines, decide nothing."""
    first, few = min(float(shares[0]), 0.15) / 0.15, float(np.mean(shares < FEW))
    shown = float(np.minimum(shares, 0.2).mean()) / 0.2
    score = 1.5 * first + sphere.coverage(_view_directions(course.Rs)) + shown
    if task.hardship == "none":
        score -= 4.0 * max(few - 0.10, 0.0)
    else:
        low, high = _HARD_SHARE
        score -= 15.0 * (max(low - few, 0.0) + 0.3 * max(few - high, 0.0))
    away = longest_run(shares < 1e-9)
    if task.hardship == "gone":
        low, high = _GONE_FRAMES
        score += 3.0 * min(away / low, 1.0) - 2.0 * max(away / high - 1, 0.0)
    else:
        score -= min(away / 20, 2.0)
    steps = turns.steps_degrees(course.Rs) * task.fps / 30
    score -= 2.0 * max(float(steps.max()) - course.fastest, 0.0)
    median = float(np.median(steps))
    score -= 6.0 * max(0.92 * course.pace - median, median - 1.1 * course.pace, 0.0)
    return round(score, 3)


def camera_in_world(style: Style, Ts: Array, body: Body) -> Array:
    """(n, 4, 4) camera from world: on the ground under the object, else where the object is in frame 0."""
    if style.world == "foot":
        return Ts @ se3.pose(np.eye(3), [*body.centre[:2], min(float(h[:, 2].min()) for h in body.hulls)])
    R = Ts[0, :3, :3] if style.world == "object" else UPRIGHT
    return np.broadcast_to(se3.pose(R, se3.transform(Ts[0], body.centre[None])[0]), Ts.shape).copy()
