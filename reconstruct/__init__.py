"""The reconstruction: from one RGB-D video to two parts, their poses, the joint between them, and meshes."""

VERSION = "12"
"""Version of the solver, stated in results: increases whenever a change moves the numbers of a result."""
