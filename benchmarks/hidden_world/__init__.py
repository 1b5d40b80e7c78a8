"""A world of its own that makes measured data with hidden effects: it imports nothing of the product, and no SAPIEN."""
