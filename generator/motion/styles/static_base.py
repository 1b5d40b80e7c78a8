"""The style `static_base`."""

from __future__ import annotations

import numpy as np

from freeart21.se3 import Array
from generator.motion import turns
from generator.motion.style import Course, Style, Task, draw_pace, hand_clock, in_hand, match_pace, plan_joint


def propose(task: Task, rng: np.random.Generator) -> Course:
    """At rest on its base; a handheld camera moves to and fro around it, higher and lower, nearer and further.

    Slower than the other styles: half as many degrees a frame take a person round an object at a metre's distance at
    walking pace.
    """
    states, course = plan_joint(task, rng)
    pace = draw_pace(task, rng, 1.1, 1.5)
    tau = hand_clock(task, course, rng)
    front, arc, pitch, tilt = rng.uniform(-0.5, 0.5), rng.uniform(1.4, 2.4), rng.uniform(0.4, 0.6), 0.35
    turn, phases = rng.uniform(1.3, 2.2), rng.uniform(0, 2 * np.pi, 2)

    def look_at_scale(scale: float) -> Array:
        s = scale * tau / 100
        yaw = front + arc * np.sin(s + phases[0])
        return turns.upright_rotation(yaw, pitch + tilt * np.sin(turn * s + phases[1]))

    return in_hand(task, match_pace(look_at_scale, 1.0, pace), tau, states, pace, rng, (0.02, 0.02, 0.12))


STYLE = Style("static_base", 4, propose, heights=(0.05, 0.82), world="foot")
