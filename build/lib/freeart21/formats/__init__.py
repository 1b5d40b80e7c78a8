"""Layouts of other people's data: `freeart21_official`, `video2articulation`, and `convert` between them and ours.

What such a folder knows of the truth comes with it (`foreign.Known`), so no method may import this package.
"""
