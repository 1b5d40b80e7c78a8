"""The interface of a style of motion, and functions that styles share: views, paces, the joint, the hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.se3 import Array
from generator.motion import timing, turns
from generator.motion.body import Body
from generator.motion.plan import Plan, Preset
from generator.motion.timing import Hold, JointCourse
from generator.motion.visibility import Atlas

Hardship = Literal["none", "hidden", "gone"]
"""Whether the smaller part is shown, nearly hidden for long, or out of sight for a while."""


HIDDEN = 0.045
"""A side with a smaller share of the object's pixels counts as hidden."""


@dataclass(frozen=True)
class Task:
    """The input of a style."""

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
    """Seed of what is the same in all candidates."""

    def hidden_area(self) -> Array:
        """(Q,) share of the style's directions from which the smaller side is hidden, at each state of the atlas."""
        z, atlas = self.atlas.directions[:, 2], self.atlas
        within = (z >= self.heights[0]) & (z <= self.heights[1])
        hidden = atlas.gone if self.hardship == "gone" else atlas.share < HIDDEN
        return np.asarray(hidden[within].mean(0))


@dataclass(frozen=True)
class Course:
    """A candidate motion without the distance to the camera."""

    Rs: Array
    """(n, 3, 3) camera from object."""
    offsets: Array
    """(n, 3) right, down, away: see `framing.place_object`."""
    clock: Array
    """(n,) frames, the hand's time: it stops while the hand rests."""
    states: Array
    """(n,) joint state, rad or m."""
    pace: float
    """Wanted median rotation, degrees a frame at 30 frames a second."""
    fastest: float = 6.5
    """Largest rotation without a penalty, degrees a frame at 30 frames a second."""


@dataclass(frozen=True)
class Style:
    """A style of motion: one file of `generator.motion.styles`, or of another package."""

    name: str
    stream: int
    """Number of its random stream, unique among styles."""
    propose: Callable[[Task, np.random.Generator], Course] | None = None
    """Draws one candidate; the planner takes the best of several."""
    plan: Callable[[Body, Array, Camera, Preset, int], Plan] | None = None
    """Instead of `propose`: the plan for given joint states (n,), of a style that needs them (a released joint)."""
    heights: tuple[float, float] = (-1.0, 1.0)
    """Sines of the lowest and highest angles from which it looks down on the object."""
    still: bool = False
    """Whether the distance to the camera is constant."""
    world: Literal["upright", "object", "foot"] = "upright"
    """The world's axes: upright, the object's in frame 0, or moving with the object, which stands on the ground."""


def plan_joint(task: Task, rng: np.random.Generator) -> tuple[Array, JointCourse]:
    """Joint states (frames,) and their course; a hard motion has a long rest where the smaller side is hidden best."""
    course = timing.joint_course(task.frames, rng, choose_long_rest(task, rng))
    return (task.body.state(course.shares) if task.states is None else task.states), course


def choose_long_rest(task: Task, rng: np.random.Generator) -> Hold | None:
    """The long rest of the joint of a hard motion, at a state in which the smaller side can be hidden; else None."""
    if task.hardship == "none":
        return None
    area = task.hidden_area() + 0.01 * (1 - task.atlas.share.min(0))
    k = int(rng.choice(len(area), p=area / area.sum()))
    at = float(np.clip(k + rng.uniform(-0.3, 0.3), 0, len(area) - 1)) / (len(area) - 1)
    return Hold(at, float(rng.uniform(0.22, 0.30)))


def draw_pace(task: Task, rng: np.random.Generator, slowest: float, fastest: float) -> float:
    """Draw a pace, radians a frame; `slowest` and `fastest` are degrees a frame at 30 frames a second."""
    return float(np.radians(rng.uniform(slowest, fastest)) * 30 / task.fps)


def hand_clock(task: Task, course: JointCourse, rng: np.random.Generator) -> Array:
    """(frames,) the hand's time: it runs unevenly, with pauses, and slowly while it hides the smaller side."""
    return timing.clock(timing.pose_rate(task.frames, course, rng, 1.0 if task.hardship == "none" else 0.55))


def plan_views(
    task: Task,
    states: Array,
    course: JointCourse,
    way: Array,
    rng: np.random.Generator,
    step: tuple[float, float],
    even: bool = True,
    highest: float = 1.0,
) -> list[Array]:
    """Views along a path whose length at each frame is `way` (frames,) radians."""
    allowed = np.abs(task.atlas.directions[:, 2]) <= highest

    def score_at(s: float) -> tuple[Array, bool]:
        frame = int(np.clip(np.searchsorted(way, s), 0, task.frames - 1))
        return score_directions(task, states, course, frame, allowed)

    start = choose_start_view(task, states, rng, allowed)
    directions = task.atlas.directions[allowed]
    return turns.choose_views(start, 1.7 * float(way[-1]) + 2 * step[1], directions, score_at, rng, step, even)


def score_directions(
    task: Task, states: Array, course: JointCourse, frame: int, allowed: NDArray[np.bool_] | None = None
) -> tuple[Array, bool]:
    """Score (D,), 0 to 1, of each of the atlas' directions that are `allowed`, in one frame; and whether to stay near.

    Directions that show both sides score high; during the joint's long rest those that hide the smaller one do.
    """
    atlas, cap = task.atlas, 0.15
    allowed = np.ones(len(atlas.directions), bool) if allowed is None else allowed
    directions = atlas.directions[allowed]
    want = 0.15 if task.hardship == "none" else 0.25
    if task.hardship != "none" and course.held is not None:
        a, b = course.held
        if a - 0.08 * task.frames <= frame <= b:  # in time to be there
            share = atlas.at_state(float(states[int(np.clip((a + b) / 2, 0, task.frames - 1))]))[allowed]
            best, width = (0.0, 0.03) if task.hardship == "gone" else (0.025, 0.06)
            hidden = 1 - np.minimum(np.abs(share - best) / width, 1)
            near = (directions @ directions[hidden >= 0.7 * hidden.max()].T).max(1)
            return 1.5 * hidden + 0.7 * near, True
    share = atlas.at_state(float(states[frame]))[allowed]
    return want * np.minimum(share / cap, 1), False


def choose_start_view(
    task: Task, states: Array, rng: np.random.Generator, allowed: NDArray[np.bool_] | None = None
) -> Array:
    """(3,) a direction that shows the smaller side well in the first frame, from not too high or low."""
    directions = task.atlas.directions
    allowed = np.ones(len(directions), bool) if allowed is None else allowed
    first = task.atlas.at_state(float(states[0]))
    level = np.abs(directions[:, 2]) < 0.75
    good = np.flatnonzero(level & allowed & (first >= np.quantile(first[level & allowed], 0.75)))
    return np.asarray(directions[int(rng.choice(good))])


def match_pace(course: Callable[[float], Array], first: float, pace: float) -> Array:
    """The rotations `course(scale)` whose median step is `pace` rad; the scale is searched from `first`."""
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


def in_hand(
    task: Task,
    Rs: Array,
    tau: Array,
    states: Array,
    pace: float,
    rng: np.random.Generator,
    drift: tuple[float, float, float],
    swing: Array | None = None,
) -> Course:
    """A course in a hand: the object drifts by `drift` (right, down, away) times `swing` (n, 3), with a tremor."""
    if swing is None:
        swing = np.stack([timing.wander(tau / task.fps, rng, 0.35) for _ in range(3)], -1)
    offsets = np.array(drift) * swing + 0.5 * timing.tremor(task.frames, task.fps, rng) * [1, 1, 0]
    return Course(
        se3.exp_so3(timing.tremor(task.frames, task.fps, rng)) @ Rs,
        offsets,
        tau,
        states,
        np.degrees(pace) * task.fps / 30,
    )
