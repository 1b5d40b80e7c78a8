"""Motion along the joint: a fast simulation under any effects, and maps of where it differs from the measurement."""
