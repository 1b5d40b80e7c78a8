"""Imports results of other projects: one file per layout, each naming the code that defines it.

`registry` finds the layouts, `importer` writes the results folder. All use `layout` and `readers`. `points` is for
point clouds, `two_states` for methods without a video, `tracked_parts` with `fitting` for methods without a joint.
docs/adapters.md lists what each layout provides and lacks.
"""
