"""Motion along the joint: a fast simulation under any effects, and where the measured one parts from it."""
