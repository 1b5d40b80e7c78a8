"""The reconstruction: from one RGB-D video to two parts, their poses, the joint between them, and meshes."""
