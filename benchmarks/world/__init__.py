"""A hidden world for `freeart21 gap`: machines with an effect that their asset does not have.

Made blind: whoever wrote it had a note on how such a test is built, docs/formats.md, docs/simgap.md and the names of
the library's effects, and had not read `simgap`. It shares no code, no formula and no random draw with it. Keep it so:
correct this world by physics and by the formats alone, never by what `gap` does with a case.

`laws` is the physics (an event-locating integrator), `machines` what stands before the sensor, `protocols` what an
experimenter does with it, `effects` what can be hidden and how large, `sensor` what is logged, `draw` a whole draw, and
how much of an effect its runs show, `grade` the score.
"""
