"""Imports results of other projects: one file per layout, each naming the code that defines it.

`importer` writes the results folder, `layout` says what a layout is, `readers` has what they share. A joint of methods
that track parts is fitted by `freeart21.joint_fit`. docs/adapters.md lists what each layout provides and lacks.
"""
