"""FreeArt-21: an open benchmark and toolchain for articulated objects that move freely in front of an RGB-D camera.

This package is the light layer (numpy and OpenCV only): geometry, types, files, effects, catalog, errors. The packages
`generator`, `reconstruct`, `export`, `leaderboard` and `simgap` import it, never the other way round.
"""

__version__ = "0.2.0"
