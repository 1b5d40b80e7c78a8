"""The style `inspect`."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array
from generator.motion import timing, turns
from generator.motion.style import Course, Style, Task, draw_pace, in_hand, plan_joint, plan_views


def propose(task: Task, rng: np.random.Generator) -> Course:
    """Shown from side to side: smooth turns between views, with short holds; in some of them the joint moves."""
    states, course = plan_joint(task, rng)
    pace = draw_pace(task, rng, 2.2, 2.6)
    t = np.arange(task.frames, dtype=float)
    views = plan_views(task, states, course, 1.15 * pace * t, rng, (0.8, 1.5), even=False)
    Rs = turns.rotations_through(views, 0.2, rng)
    steps = se3.log_so3(np.swapaxes(Rs[:-1], 1, 2) @ Rs[1:])
    lengths, luck = np.linalg.norm(steps, axis=1), rng.uniform(0, 1, (2, len(Rs)))

    def turn_at_speed(speed: float) -> tuple[Array, Array]:
        """Rotations (frames, 3, 3) at a mean angular speed, radians a frame, and the view number (frames,) reached."""
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
        median = np.radians(float(np.median(turns.steps_degrees(turn_at_speed(speed)[0]))))
        speed = float(np.clip(speed * (pace / max(median, 1e-9)) ** 0.7, 0.9 * pace, 1.6 * pace))
    turned, u = turn_at_speed(speed)
    return in_hand(task, turned, 25.0 * u, states, pace, rng, (0.03, 0.015, 0.05))


STYLE = Style("inspect", 1, propose)
