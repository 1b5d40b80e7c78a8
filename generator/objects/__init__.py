"""The procedural objects: one module a category, each with `build(seed) -> ObjectModel`."""

from __future__ import annotations

import importlib

from generator.model import ObjectModel


def build(name: str, seed: int) -> ObjectModel:
    """The procedural object `name` of the catalog; sizes and colours vary with the seed."""
    return importlib.import_module(f"generator.objects.{name}").build(seed)
