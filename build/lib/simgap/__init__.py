"""Finding where simulation and measurement disagree, naming the missing effect, adding it."""
