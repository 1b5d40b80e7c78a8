"""Finding where simulation and measurement differ, naming the missing effect, adding it to the asset."""
