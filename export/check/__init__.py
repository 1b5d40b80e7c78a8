"""Checks of any URDF or MJCF for use in simulators: rules on its files, and trials in every installed engine."""
