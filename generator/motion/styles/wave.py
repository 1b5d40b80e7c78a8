"""The style `wave`."""

from __future__ import annotations

import numpy as np

from freeart21 import se3
from generator.motion import style, timing, turns
from generator.motion.style import Course, Style, Task


def propose(task: Task, rng: np.random.Generator) -> Course:
    """Held roughly upright, swung and shaken, while it turns slowly and the joint moves."""
    states, course = style.plan_joint(task, rng)
    pace = style.draw_pace(task, rng, 2.2, 2.7)
    slow = style.draw_pace(task, rng, 0.5, 0.8) if task.hardship == "none" else style.draw_pace(task, rng, 1.2, 1.6)
    tau = style.hand_clock(task, course, rng)
    highest = 0.6 if task.hardship == "none" else 1.0
    views = style.plan_views(task, states, course, slow * tau, rng, (0.5, 0.9), highest=highest)
    base = turns.rotations_through(views, 0.1, rng)
    drift = turns.spline(base, slow / 0.6 * tau)
    swings = [timing.wander(tau / task.fps, rng, rng.uniform(0.8, 1.2)) for _ in range(6)]
    shake = np.stack(swings[:3], -1) * np.array([0.6, 1.0, 0.5])
    shake -= shake[0]
    Rs = style.match_pace(lambda size: se3.exp_so3(size * shake) @ drift, 0.2, pace)
    return style.in_hand(task, Rs, tau, states, pace, rng, (0.10, 0.04, 0.08), np.stack(swings[3:], -1))


STYLE = Style("wave", 2, propose)
