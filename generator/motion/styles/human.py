"""The style `human`: an object in a person's hands, from distributions of motion capture (`human_hand`)."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array
from generator.motion import human_hand, timing, turns
from generator.motion.human_hand import BACK, ON, Sweep
from generator.motion.style import Course, Style, Task, choose_long_rest, choose_start_view, score_directions

_TREMOR = 2.1
"""Factor on `timing.tremor`: an object held still then turns by .040 degrees a frame in the median, as measured, and
shifts by .0003 diagonals."""
_AWAY = 0.8
"""The object's diagonal as a share of the distance, where it fills two thirds of a picture of 40 degrees of view."""
_ROOM = np.array([0.20, 0.08, 0.20])
"""Largest offset of the object right, down and away, as shares of the distance: further away it is small in the
picture. People carry it further (in 10 s by .1 to 1.5 diagonals each way)."""
_DIRECTIONS = 48  # candidate axes of a sweep
_RAMP = 0.2  # s in which a hand releases or grasps the object


def propose(task: Task, rng: np.random.Generator) -> Course:
    """In a person's hands: sweeps, holds and corrections, sometimes put down; the joint moves independently."""
    # candidates differ in directions only, so that the choice among them favours neither larger sweeps nor fewer rests
    motion = human_hand.draw_hand(task.frames, task.fps, np.random.default_rng([*task.seed, 11]))
    course = human_hand.draw_joint_course(task.frames, task.fps, rng, choose_long_rest(task, rng))
    states = task.body.state(course.shares) if task.states is None else task.states
    Rs = turns.upright_looking_from(choose_start_view(task, states, rng))[None]
    place, before = np.zeros(3), np.zeros(3)
    offsets, rate = np.zeros((task.frames, 3)), np.zeros(task.frames)
    for sweep in motion.sweeps:
        arrives = int(np.clip(sweep.start + sweep.length, 0, task.frames - 1))
        wanted, _ = score_directions(task, states, course, arrives)
        axis = _choose_axis(Rs[-1], sweep, before, task.atlas.directions, wanted, rng)
        to = _choose_place(place, _AWAY * sweep.way, rng)
        done = sweep.course(task.frames)
        Rs = se3.exp_so3(np.radians(sweep.degrees) * done[:, None] * axis) @ Rs
        offsets += done[:, None] * (to - place)
        rate += sweep.degrees * np.gradient(done)
        place, before = to, axis
    Rs = np.broadcast_to(Rs, (task.frames, 3, 3))
    held = _TREMOR * _held_in_hand(motion.resting_on_table, task.frames, task.fps)[:, None]
    offsets += 0.5 * held * timing.tremor(task.frames, task.fps, rng) * [1, 1, 0]
    Rs = se3.exp_so3(held * timing.tremor(task.frames, task.fps, rng)) @ Rs
    pace = float(np.median(turns.steps_degrees(Rs)))
    clock = timing.clock(rate / max(float(rate.mean()), 1e-9))
    return Course(Rs, offsets, clock, states, pace * task.fps / 30, human_hand.FASTEST)


def _choose_axis(
    R: Array, sweep: Sweep, before: Array, directions: Array, wanted: Array, rng: np.random.Generator
) -> Array:
    """(3,) unit axis, in camera axes, of a sweep from the rotation `R` (3, 3).

    It continues the sweep before, reverses it or turns aside, with the frequencies of people; among such axes the one
    whose end view has the best score is taken.
    """
    axes = rng.normal(size=(_DIRECTIONS, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    cosine, luck = axes @ before, rng.uniform()
    kind = cosine > 0.5 if luck < ON else cosine < -0.5 if luck < ON + BACK else np.abs(cosine) <= 0.5
    axes = axes[kind] if kind.any() and before.any() else axes
    ends = -(se3.exp_so3(np.radians(sweep.degrees) * axes) @ R)[:, 2]
    near = (ends @ directions.T).argmax(1)
    score = 3.0 * wanted[near] + rng.uniform(0, 0.5, len(axes))  # the weights of `turns.choose_views`
    return np.asarray(axes[int(score.argmax())])


def _choose_place(place: Array, way: float, rng: np.random.Generator) -> Array:
    """(3,) end of a sweep with the translation `way`: of three random directions the one nearest to the middle."""
    steps = rng.normal(size=(3, 3))
    ends = place + way * steps / np.linalg.norm(steps, axis=1, keepdims=True)
    best = ends[int(np.abs(ends / _ROOM).max(1).argmin())]
    return np.asarray(np.clip(best, -_ROOM, _ROOM))


def _held_in_hand(resting_on_table: tuple[tuple[float, float], ...], frames: int, fps: float) -> Array:
    """(frames,) 1 while the object is in the hand, 0 while it rests on the table."""
    t, held = np.arange(frames, dtype=float), np.ones(frames)
    for a, b in resting_on_table:
        ramp = _RAMP * fps
        held *= 1 - timing.ease((t - a) / ramp) * timing.ease((b - t) / ramp)
    return held


STYLE = Style("human", 6, propose)
