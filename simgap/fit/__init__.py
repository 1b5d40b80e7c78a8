"""Sets of effects fitted to runs, and the search for those that explain them."""
