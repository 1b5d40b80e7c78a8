"""Articulated Gaussians: both parts as one model that is fitted to all frames (paper, End-to-end Optimization)."""
