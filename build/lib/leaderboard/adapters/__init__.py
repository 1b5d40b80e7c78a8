"""Results as other projects write them become ours: one file a layout, each naming the code in which it was read.

`registry` knows them all, `importer` writes the results folder, `toolbox` holds what they share: what was found of a
sequence, frames, units and readers that trust nothing. docs/adapters.md says what each layout gives and lacks.
"""
