"""The procedural objects: one module a category, one function an object, each `seed -> ObjectModel`."""

from __future__ import annotations

import importlib

from freeart21 import catalog
from freeart21.errors import FreeArtError
from generator.model import ObjectModel

MODULES = {
    "USB": "usb",
    "Lighter": "lighter",
    "Stapler": "stapler",
    "Phone": "phone",
    "Scissors": "scissors",
    "StorageFurniture": "storage",
    "Display": "display",
}
"""Category to the module of its objects."""


def build(name: str, seed: int) -> ObjectModel:
    """The procedural object `name` of the catalog; sizes, colours and details vary with the seed.

    Raises FreeArtError when the catalog holds no procedural object of that name.
    """
    entry = catalog.find(name)
    if entry.source != "procedural":
        raise FreeArtError(f"'{name}' is not procedural; procedural objects: {', '.join(catalog.built_in_names())}")
    model: ObjectModel = getattr(importlib.import_module(f"generator.objects.{MODULES[entry.category]}"), name)(seed)
    return model
