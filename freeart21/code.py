"""What source code does, as a fingerprint: comments, docstrings and layout left out."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any


def code_digest(modules: Iterable[tuple[str, Path]]) -> str:
    """SHA-256, hexadecimal, of what Python modules do: their (name, file), in a given order."""
    digest = hashlib.sha256()
    for name, path in modules:
        digest.update(f"{name}\n".encode())
        _add_meaning(digest, path.read_text("utf-8"))
    return digest.hexdigest()


def source_digest(source: str) -> str:
    """SHA-256, hexadecimal, of what the Python text `source` does."""
    digest = hashlib.sha256()
    _add_meaning(digest, source)
    return digest.hexdigest()


def modules_behind(module: str, root: Path, packages: Iterable[str]) -> dict[str, Path]:
    """Module name to file of `module` and all that it may import, at any depth, of the `packages` in the folder `root`.

    Read from the import statements, those within functions too. Not seen: what is imported by a computed name, and
    packages that are only on the way to a module (ours merely name what they hold).
    """
    packages = frozenset(packages)
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = root.joinpath(*name.split("."))
        file = next((f for f in (path.with_suffix(".py"), path / "__init__.py") if f.is_file()), None)
        if name in found or file is None or name.split(".")[0] not in packages:
            continue
        found[name] = file
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                waiting += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return dict(sorted(found.items()))


def _add_meaning(digest: hashlib._Hash, source: str) -> None:
    for word in _meaning(ast.parse(source)):
        digest.update(f"{word} ".encode())


def _meaning(node: Any) -> Iterator[str]:
    """The words of a syntax tree: kinds of nodes, names and constants; what a Python version adds empty is left out."""
    if isinstance(node, list):
        yield "["
        for entry in node:
            text = isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant)
            if not (text and isinstance(entry.value.value, str)):  # a docstring, of a field perhaps
                yield from _meaning(entry)
        yield "]"
    elif isinstance(node, ast.AST):
        yield type(node).__name__
        for name, value in ast.iter_fields(node):
            if value is not None and value != []:
                yield name
                yield from _meaning(value)
    else:
        yield repr(node)
