"""What a robot simulator wants of any URDF or MJCF: rules on its files, and trials in every installed engine."""
