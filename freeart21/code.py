"""Fingerprints of source code: comments, docstrings and layout do not count."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any


def code_digest(modules: Iterable[tuple[str, Path]]) -> str:
    """SHA-256, hexadecimal, of the syntax trees of Python modules, given as (name, file) in a fixed order."""
    digest = hashlib.sha256()
    for name, path in modules:
        digest.update(f"{name}\n".encode())
        _add_syntax(digest, path.read_text("utf-8"))
    return digest.hexdigest()


def source_digest(source: str) -> str:
    """SHA-256, hexadecimal, of the syntax tree of the Python text `source`."""
    digest = hashlib.sha256()
    _add_syntax(digest, source)
    return digest.hexdigest()


def modules_behind(module: str, root: Path, packages: Iterable[str]) -> dict[str, Path]:
    """Module name to file, of `module` and of all that it may import, at any depth, from `packages` in `root`.

    Read from import statements, also those inside functions. Imports by a computed name are not found, nor are the
    packages on the way to a module.
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


def _add_syntax(digest: hashlib._Hash, source: str) -> None:
    for word in _syntax_words(ast.parse(source)):
        digest.update(f"{word} ".encode())


def _syntax_words(node: Any) -> Iterator[str]:
    """Node types, names and constants of a syntax tree. Empty fields, which differ by Python version, are left out."""
    if isinstance(node, list):
        yield "["
        for entry in node:
            text = isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant)
            if not (text and isinstance(entry.value.value, str)):  # a docstring, also of a field
                yield from _syntax_words(entry)
        yield "]"
    elif isinstance(node, ast.AST):
        yield type(node).__name__
        for name, value in ast.iter_fields(node):
            if value is not None and value != []:
                yield name
                yield from _syntax_words(value)
    else:
        yield repr(node)
