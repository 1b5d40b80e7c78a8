"""The motions of the recorder: how object, camera and joint move over a video.

`plan_motion` draws a few candidates of a style (`styles`), smooth courses of rotations (`turns`) and joint states with
pauses (`timing`). What each shows is looked up in a table of what can be seen from where (`visibility`), and the
distance follows from the picture (`framing`). `release` lets go of the joint; its states come from a roll-out
(`generator.release`). `track` replays what somebody did.
"""

from generator.motion.body import hull_points, motion_range
from generator.motion.plan import PRESETS, Plan, Preset
from generator.motion.planner import plan_motion
from generator.motion.styles import STYLES

__all__ = [
    "PRESETS",
    "STYLES",
    "Plan",
    "Preset",
    "hull_points",
    "motion_range",
    "plan_motion",
]
