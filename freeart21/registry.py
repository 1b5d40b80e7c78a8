"""Members of a kind, one module each: in a folder of ours, or in an installed package that names it as an entry point.

A package of somebody else adds, say, an effect by two lines of its pyproject.toml and a module like one of ours:

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
    """The instance of `kind` that each member module of `package` defines, by its `name`, sorted.

    Raises FreeArtError when two members have one name, or an entry point's module can't be imported or defines none.
    """
    return _by_name(package, kind, lambda value, module: isinstance(value, kind))


def find_classes(package: str, kind: type[T]) -> dict[str, type[T]]:
    """The subclass of `kind` with a `name` that each member module of `package` defines, by that name, sorted.

    Raises FreeArtError as `find_instances` does.
    """

    def defines(value: Any, module: ModuleType) -> bool:
        return inspect.isclass(value) and issubclass(value, kind) and value.__module__ == module.__name__

    return _by_name(package, kind, defines)


def _by_name(package: str, kind: type, is_member: Any) -> dict[str, Any]:
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
    """Modules of the folder, then those that entry points of the group `package` name, with the place to blame."""
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
