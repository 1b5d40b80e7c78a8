"""The styles: how object, camera and joint are moved, as candidates to choose from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from generator.motion import timing, turns
from generator.motion.body import Body
from generator.motion.timing import Hold, JointCourse
from generator.motion.visibility import Atlas

Hardship = Literal["none", "hidden", "gone"]
"""Whether the smaller part is to be shown, nearly hidden for long, or out of sight for a while."""


HIDDEN = 0.045
"""A side whose share of the object's pixels is below counts as hidden."""

HEIGHTS: dict[str, tuple[float, float]] = {"turntable": (0.2, 0.65), "static_base": (0.05, 0.82)}
"""Sines of the angles from which a style looks down, where it does not look from everywhere."""


@dataclass(frozen=True)
class Task:
    """What a style is asked for."""

    body: Body
    atlas: Atlas
    frames: int
    fps: float
    hardship: Hardship
    states: Array | None
    """(frames,) given joint states, rad or m; None when they are to be planned."""
    heights: tuple[float, float] = (-1.0, 1.0)
    """Sines of the lowest and highest angles from which the style looks down on the object."""
    seed: tuple[int, ...] = (0,)
    """The plan's: what is one and the same in all candidates is drawn from it."""

    def hidden_area(self) -> Array:
        """(Q,) share of the style's directions from which the smaller side is hidden, at each state of the atlas."""
        z, atlas = self.atlas.directions[:, 2], self.atlas
        within = (z >= self.heights[0]) & (z <= self.heights[1])
        hidden = atlas.gone if self.hardship == "gone" else atlas.share < HIDDEN
        return np.asarray(hidden[within].mean(0))


@dataclass(frozen=True)
class Course:
    """A candidate: everything but the distance."""

    Rs: Array
    """(n, 3, 3) camera from object."""
    sway: Array
    """(n, 3) right, down, away: see `framing.placed`."""
    clock: Array
    """(n,) the hand's time, frames."""
    states: Array
    """(n,) joint state, rad or m."""
    pace: float
    """The median step that was wanted, degrees a frame at 30 frames a second."""
    fastest: float = 6.5
    """The largest step that is welcome, degrees a frame at 30 frames a second."""


def tumble(task: Task, rng: np.random.Generator) -> Course:
    """Turned over and over in the hand, with pauses, while the joint is worked."""
    states, course = _joint(task, rng)
    pace = _pace(task, rng, 2.3, 2.8)
    tau = timing.clock(timing.pose_rate(task.frames, course, rng, _linger(task)))
    views = _views(task, states, course, 1.1 * pace * tau, rng, (0.7, 1.1))
    Rs = turns.rolled(views, 0.35, rng)
    Rs = _paced(lambda scale: turns.spline(Rs, _within(Rs, scale * tau)), pace, pace)
    return _held(task, Rs, tau, states, pace, rng, (0.04, 0.02, 0.06))


def inspect(task: Task, rng: np.random.Generator) -> Course:
    """Shown side after side: eased turns between views, with short holds, in some of which the joint is worked."""
    states, course = _joint(task, rng)
    pace = _pace(task, rng, 2.2, 2.6)
    t = np.arange(task.frames, dtype=float)
    views = _views(task, states, course, 1.15 * pace * t, rng, (0.8, 1.5), even=False)
    Rs = turns.rolled(views, 0.2, rng)
    steps = se3.log_so3(np.swapaxes(Rs[:-1], 1, 2) @ Rs[1:])
    lengths, luck = np.linalg.norm(steps, axis=1), rng.uniform(0, 1, (2, len(Rs)))

    def shown(speed: float) -> tuple[Array, Array]:
        """Rotations at a mean speed of turning, radians a frame, and how many views have been shown."""
        start, u, long = 2.0, np.zeros(task.frames), 0
        for k, length in enumerate(lengths):
            last = start + max(length / speed, 10.0)
            u += timing.glide((t - start) / (last - start))
            working = any(a < last < b - 12 for a, b in course.moves)
            hidden = course.held is not None and course.held[0] < last < course.held[1] and task.hardship != "none"
            worked = working and luck[0, k] < 0.6 and long < max(task.frames // 100, 1)
            long += worked
            start = last + 2 + 4 * luck[1, k] + 16 * worked + 6 * hidden
        k = np.clip(np.floor(u).astype(int), 0, len(Rs) - 2)
        return Rs[k] @ se3.exp_so3((u - k)[:, None] * steps[k]), u

    speed = pace * 1.1
    for _ in range(6):
        median = np.radians(float(np.median(turns.steps_degrees(shown(speed)[0]))))
        speed = float(np.clip(speed * (pace / max(median, 1e-9)) ** 0.7, 0.9 * pace, 1.6 * pace))
    turned, u = shown(speed)
    return _held(task, turned, 25.0 * u, states, pace, rng, (0.03, 0.015, 0.05))


def wave(task: Task, rng: np.random.Generator) -> Course:
    """Held about upright, swung and shaken, while it turns slowly round and the joint is worked."""
    states, course = _joint(task, rng)
    pace = _pace(task, rng, 2.2, 2.7)
    slow = _pace(task, rng, 0.5, 0.8) if task.hardship == "none" else _pace(task, rng, 1.2, 1.6)
    tau = timing.clock(timing.pose_rate(task.frames, course, rng, _linger(task)))
    highest = 0.6 if task.hardship == "none" else 1.0
    views = _views(task, states, course, slow * tau, rng, (0.5, 0.9), highest=highest)
    base = turns.rolled(views, 0.1, rng)
    drift = turns.spline(base, _within(base, slow / 0.6 * tau))
    swings = [timing.wander(tau / task.fps, rng, rng.uniform(0.8, 1.2)) for _ in range(6)]
    shake = np.stack(swings[:3], -1) * np.array([0.6, 1.0, 0.5])
    shake -= shake[0]
    Rs = _paced(lambda size: se3.exp_so3(size * shake) @ drift, 0.2, pace)
    return _held(task, Rs, tau, states, pace, rng, (0.10, 0.04, 0.08), np.stack(swings[3:], -1))


def turntable(task: Task, rng: np.random.Generator) -> Course:
    """Standing upright on a plate that turns steadily; the camera rests and looks a little down."""
    states, _ = _joint(task, rng)
    pace = _pace(task, rng, 2.2, 2.8) * rng.choice([-1, 1])
    yaw = rng.uniform(-np.pi, np.pi) + pace * np.arange(task.frames)
    Rs = turns.level(yaw, np.full(task.frames, rng.uniform(0.2, 0.7)))
    return Course(Rs, np.zeros((task.frames, 3)), np.zeros(task.frames), states, abs(np.degrees(pace)) * task.fps / 30)


def static_base(task: Task, rng: np.random.Generator) -> Course:
    """At rest on its base while a camera in a hand goes to and fro round it, higher and lower, nearer and further.

    Slower than the other styles: half as many degrees a frame take a person round an object at a metre's distance at
    walking pace.
    """
    states, course = _joint(task, rng)
    pace = _pace(task, rng, 1.1, 1.5)
    tau = timing.clock(timing.pose_rate(task.frames, course, rng, _linger(task)))
    front, arc, pitch, tilt = rng.uniform(-0.5, 0.5), rng.uniform(1.4, 2.4), rng.uniform(0.4, 0.6), 0.35
    turn, phases = rng.uniform(1.3, 2.2), rng.uniform(0, 2 * np.pi, 2)

    def seen(scale: float) -> Array:
        s = scale * tau / 100
        yaw = front + arc * np.sin(s + phases[0])
        return turns.level(yaw, pitch + tilt * np.sin(turn * s + phases[1]))

    return _held(task, _paced(seen, 1.0, pace), tau, states, pace, rng, (0.02, 0.02, 0.12))


STYLES: dict[str, Callable[[Task, np.random.Generator], Course]] = {
    "tumble": tumble,
    "inspect": inspect,
    "wave": wave,
    "turntable": turntable,
    "static_base": static_base,
}


def _joint(task: Task, rng: np.random.Generator) -> tuple[Array, JointCourse]:
    """States (frames,) and when they move; a hard motion rests where the smaller side can be hidden best."""
    course = timing.joint_course(task.frames, rng, long_rest(task, rng))
    return (task.body.state(course.shares) if task.states is None else task.states), course


def long_rest(task: Task, rng: np.random.Generator) -> Hold | None:
    """Where the joint of a hard motion rests for long: where the smaller side can be hidden best."""
    if task.hardship == "none":
        return None
    area = task.hidden_area() + 0.01 * (1 - task.atlas.share.min(0))
    k = int(rng.choice(len(area), p=area / area.sum()))
    at = float(np.clip(k + rng.uniform(-0.3, 0.3), 0, len(area) - 1)) / (len(area) - 1)
    return Hold(at, float(rng.uniform(0.22, 0.30)))


def _pace(task: Task, rng: np.random.Generator, slowest: float, fastest: float) -> float:
    """Radians a frame: between so many degrees at 30 frames a second."""
    return float(np.radians(rng.uniform(slowest, fastest)) * 30 / task.fps)


def _linger(task: Task) -> float:
    """How much slower the hand is while it hides the smaller side."""
    return 1.0 if task.hardship == "none" else 0.55


def _views(
    task: Task,
    states: Array,
    course: JointCourse,
    way: Array,
    rng: np.random.Generator,
    step: tuple[float, float],
    even: bool = True,
    highest: float = 1.0,
) -> list[Array]:
    """Views for a path that has come `way` (frames,) radians in every frame: both sides shown, or one hidden."""
    usual = np.abs(task.atlas.directions[:, 2]) <= highest

    def wish(s: float) -> tuple[Array, bool]:
        frame = int(np.clip(np.searchsorted(way, s), 0, task.frames - 1))
        return welcome(task, states, course, frame, usual)

    start = start_view(task, states, rng, usual)
    directions = task.atlas.directions[usual]
    return turns.tour(start, 1.7 * float(way[-1]) + 2 * step[1], directions, wish, rng, step, even)


def welcome(
    task: Task, states: Array, course: JointCourse, frame: int, usual: NDArray[np.bool_] | None = None
) -> tuple[Array, bool]:
    """How welcome each of the atlas' directions (those `usual`) is in a frame, (D,), 0 to 1, and whether to stay there:
    both sides shown, or one hidden during the joint's long rest."""
    atlas, cap = task.atlas, 0.15
    usual = np.ones(len(atlas.directions), bool) if usual is None else usual
    directions = atlas.directions[usual]
    want = 0.15 if task.hardship == "none" else 0.25
    if task.hardship != "none" and course.held is not None:
        a, b = course.held
        if a - 0.08 * task.frames <= frame <= b:  # in time to be there
            share = atlas.at_state(float(states[int(np.clip((a + b) / 2, 0, task.frames - 1))]))[usual]
            best, width = (0.0, 0.03) if task.hardship == "gone" else (0.025, 0.06)
            hidden = 1 - np.minimum(np.abs(share - best) / width, 1)
            near = (directions @ directions[hidden >= 0.7 * hidden.max()].T).max(1)
            return 1.5 * hidden + 0.7 * near, True
    share = atlas.at_state(float(states[frame]))[usual]
    return want * np.minimum(share / cap, 1), False


def start_view(task: Task, states: Array, rng: np.random.Generator, usual: NDArray[np.bool_] | None = None) -> Array:
    """(3,) a direction that shows the smaller side well in the first frame, from not too high or low."""
    directions = task.atlas.directions
    usual = np.ones(len(directions), bool) if usual is None else usual
    first = task.atlas.at_state(float(states[0]))
    level = np.abs(directions[:, 2]) < 0.75
    good = np.flatnonzero(level & usual & (first >= np.quantile(first[level & usual], 0.75)))
    return np.asarray(directions[int(rng.choice(good))])


def _within(Rs: Array, u: Array) -> Array:
    return np.clip(u, 0, len(Rs) - 1)


def _paced(course: Callable[[float], Array], first: float, pace: float) -> Array:
    """The rotations `course(scale)` at the scale, searched from `first`, at which their median step is `pace` rad."""
    scale, best = first, (np.inf, course(first))
    for _ in range(14):
        Rs = course(scale)
        median = max(np.radians(float(np.median(turns.steps_degrees(Rs)))), 1e-6)
        error = abs(np.log(median / pace))
        if error < best[0]:
            best = error, Rs
        if error < 0.01:
            break
        scale *= float(np.clip(pace / median, 0.5, 2.0)) ** 0.8
    return best[1]


def _held(
    task: Task,
    Rs: Array,
    tau: Array,
    states: Array,
    pace: float,
    rng: np.random.Generator,
    drift: tuple[float, float, float],
    swing: Array | None = None,
) -> Course:
    """A course in a hand: `drift` is the size of its sway, and the hand is never quite at rest."""
    if swing is None:
        swing = np.stack([timing.wander(tau / task.fps, rng, 0.35) for _ in range(3)], -1)
    sway = np.array(drift) * swing + 0.5 * timing.tremor(task.frames, task.fps, rng) * [1, 1, 0]
    return Course(
        se3.exp_so3(timing.tremor(task.frames, task.fps, rng)) @ Rs, sway, tau, states, np.degrees(pace) * task.fps / 30
    )
