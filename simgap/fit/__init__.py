"""Fits of sets of effects to runs, and the search over sets."""
