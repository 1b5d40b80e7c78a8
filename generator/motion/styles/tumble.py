"""The style `tumble`."""

from __future__ import annotations

import numpy as np

from generator.motion import style, turns
from generator.motion.style import Course, Style, Task


def propose(task: Task, rng: np.random.Generator) -> Course:
    """Turned over and over in the hand, with pauses, while the joint moves."""
    states, course = style.plan_joint(task, rng)
    pace = style.draw_pace(task, rng, 2.3, 2.8)
    tau = style.hand_clock(task, course, rng)
    views = style.plan_views(task, states, course, 1.1 * pace * tau, rng, (0.7, 1.1))
    Rs = turns.rotations_through(views, 0.35, rng)
    Rs = style.match_pace(lambda scale: turns.spline(Rs, scale * tau), pace, pace)
    return style.in_hand(task, Rs, tau, states, pace, rng, (0.04, 0.02, 0.06))


STYLE = Style("tumble", 0, propose)
