"""The procedural objects: one function an object, each `seed -> ObjectModel`, in a module of this folder."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable

from freeart21 import catalog
from freeart21.errors import FreeArtError
from generator.model import ObjectModel


def build(name: str, seed: int) -> ObjectModel:
    """The procedural object `name` of the catalog; sizes, colours and details vary with the seed.

    Raises FreeArtError when the catalog holds no procedural object of that name.
    """
    if catalog.find(name).source != "procedural":
        raise FreeArtError(f"'{name}' is not procedural; procedural objects: {', '.join(catalog.built_in_names())}")
    return _find_builder(name)(seed)


def _find_builder(name: str) -> Callable[[int], ObjectModel]:
    """The function `name` of the module that defines it."""
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        function = vars(module).get(name)
        if inspect.isfunction(function) and function.__module__ == module.__name__:
            return function
    raise AssertionError(f"no module of {__name__} defines {name}")
