"""What was measured, as fits see it: readings with their noise, inputs between rows, motion."""
