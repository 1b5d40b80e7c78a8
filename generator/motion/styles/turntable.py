"""The style `turntable`."""

from __future__ import annotations

import numpy as np

from generator.motion import turns
from generator.motion.style import Course, Style, Task, draw_pace, plan_joint


def propose(task: Task, rng: np.random.Generator) -> Course:
    """Upright on a turntable of constant speed; the camera is at rest and looks slightly down."""
    states, _ = plan_joint(task, rng)
    pace = draw_pace(task, rng, 2.2, 2.8) * rng.choice([-1, 1])
    yaw = rng.uniform(-np.pi, np.pi) + pace * np.arange(task.frames)
    Rs = turns.upright_rotation(yaw, np.full(task.frames, rng.uniform(0.2, 0.7)))
    return Course(Rs, np.zeros((task.frames, 3)), np.zeros(task.frames), states, abs(np.degrees(pace)) * task.fps / 30)


STYLE = Style("turntable", 3, propose, heights=(0.2, 0.65), still=True, world="object")
