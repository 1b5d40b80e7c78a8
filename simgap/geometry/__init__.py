"""The joint's own geometry, from part poses alone."""
