"""A second hidden world for `freeart21 gap`: machines with an effect that their asset does not have.

Made blind on purpose: whoever wrote it had a note on how such a test has to be built, docs/formats.md, docs/simgap.md
and the names of the library's effects (the files' in freeart21/effects, unread), and had read neither `simgap` nor the
first hidden world nor its scorer. It shares no code, no formula and no random draw with either. So what `gap` was
taught by the first world does not help it here. Keep it so: mend this world by physics and by the formats alone, never
by looking at what `gap` does with a case.

`laws` is the physics (an event-locating integrator), `mujoco_check` the same machines in another engine, `machines`
what stands before the sensor, `protocols` what an experimenter does with it, `hidden` which effects there are and how
large, `strata` which are asked for and where, `strength` how much of one the runs show, `draw` a whole draw, `sensor`
what is logged, `seal` data apart from labels, `asked` the command as a user runs it, `physics_says` which answers are
right by physics, `grade` and `tables` the score.
"""
