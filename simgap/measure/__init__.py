"""Measured runs as fits take them: readings with noise, inputs between rows, base motion."""
