"""The motions of the recorder: how object, camera and joint move over a video.

`plan_motion` draws several candidates of a style (`styles`): smooth rotations (`turns`) and joint states with pauses
(`timing`). It scores them by a table of visibility (`visibility`) and sets the distance so that the object fills the
picture (`framing`). The style `release` shows a simulated roll-out of the joint (`generator.release`). `track` replays
a take.
"""

from generator.motion.body import hull_points, motion_range
from generator.motion.plan import PRESETS, Plan, Preset
from generator.motion.planner import plan_motion
from generator.motion.styles import STYLES

__all__ = ["PRESETS", "STYLES", "Plan", "Preset", "hull_points", "motion_range", "plan_motion"]
