"""The exporter: a reconstruction becomes a URDF with meshes that simulators load."""
