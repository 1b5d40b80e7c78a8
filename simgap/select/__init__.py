"""Which set stands, and what is said of it."""
