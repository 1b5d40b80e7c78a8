"""The style `tumble`."""

from __future__ import annotations

import numpy as np

from generator.motion import timing, turns
from generator.motion.style import (
    Course,
    Style,
    Task,
    clip_to_views,
    in_hand,
    joint_states,
    match_pace,
    pace_per_frame,
    plan_views,
    slow_down,
)


def propose(task: Task, rng: np.random.Generator) -> Course:
    """Turned over and over in the hand, with pauses, while the joint is worked."""
    states, course = joint_states(task, rng)
    pace = pace_per_frame(task, rng, 2.3, 2.8)
    tau = timing.clock(timing.pose_rate(task.frames, course, rng, slow_down(task)))
    views = plan_views(task, states, course, 1.1 * pace * tau, rng, (0.7, 1.1))
    Rs = turns.rolled(views, 0.35, rng)
    Rs = match_pace(lambda scale: turns.spline(Rs, clip_to_views(Rs, scale * tau)), pace, pace)
    return in_hand(task, Rs, tau, states, pace, rng, (0.04, 0.02, 0.06))


STYLE = Style("tumble", 0, propose)
