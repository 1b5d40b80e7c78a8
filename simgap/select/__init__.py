"""Model selection among sets of effects, and the verdict."""
