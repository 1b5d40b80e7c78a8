"""The joint's geometry, from part poses alone."""
