"""Finds extension modules: in a folder of this project, or in an installed package with an entry point.

A third-party package adds an effect, for example, by two lines of its pyproject.toml and a module like those here:

    [project.entry-points."freeart21.effects"]
    squeak = "their_package.squeak"
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType
from typing import Any, TypeVar

from freeart21.errors import FreeArtError

T = TypeVar("T")


def find_instances(package: str, kind: type[T]) -> dict[str, T]:
    """Name to the instance of `kind` in each module of `package`, sorted by name.

    Raises FreeArtError on a duplicate name, or when the module of an entry point cannot be imported or has no instance.
    """
    return _by_name(package, kind, lambda value, module: isinstance(value, kind))


def find_classes(package: str, kind: type[T]) -> dict[str, type[T]]:
    """Name to the subclass of `kind` with a `name` in each module of `package`, sorted by name.

    Raises FreeArtError as `find_instances` does.
    """

    def defines(value: Any, module: ModuleType) -> bool:
        # in Python 3.10 isclass(list[int]) is true, and issubclass refuses it
        return inspect.isclass(value) and value.__module__ == module.__name__ and issubclass(value, kind)

    return _by_name(package, kind, defines)


def _by_name(package: str, kind: type[Any], is_member: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for module, where in _modules(package):
        own = [value for value in vars(module).values() if is_member(value, module) and hasattr(value, "name")]
        if where and not own:
            raise FreeArtError(f"{where}: module {module.__name__} defines no {kind.__name__} with a name")
        for member in own:
            if found.setdefault(member.name, member) is not member:
                raise FreeArtError(f"{where or module.__name__}: name already taken: {kind.__name__} '{member.name}'")
    return dict(sorted(found.items()))


def _modules(package: str) -> Iterator[tuple[ModuleType, str]]:
    """Modules of the folder, then those of entry points of the group `package`, each with its place for messages."""
    for info in pkgutil.iter_modules(importlib.import_module(package).__path__):
        yield importlib.import_module(f"{package}.{info.name}"), ""
    from importlib.metadata import entry_points  # 20 ms

    for point in entry_points(group=package):
        where = f"entry point {package}: {point.name} = {point.value}"
        try:
            module = point.load()
        except (ImportError, AttributeError) as error:
            raise FreeArtError(f"{where}: {error}") from error
        if not inspect.ismodule(module):
            raise FreeArtError(f"{where}: expected a module, got {type(module).__name__}")
        yield module, where
