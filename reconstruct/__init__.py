"""The reconstruction: from one RGB-D video to two parts, their poses, the joint between them, and meshes."""

VERSION = "7"
"""Of the solver: goes up whenever a change moves the numbers of a result. Results say by which version they are."""
