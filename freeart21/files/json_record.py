"""Dataclasses from untrusted JSON: the types of the fields are what the file must hold."""

from __future__ import annotations

import types
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from freeart21.errors import FreeArtError
from freeart21.files import checked

_T = TypeVar("_T")
_WORDS = {str: "text", bool: "true or false", int: "a whole number", float: "a finite number", type(None): "null"}


def read_record(kind: type[_T], data: Any, where: str, whole: bool = False) -> _T:
    """The dataclass `kind` in the JSON value `data`; fields that it lacks keep their defaults.

    With `whole` it is a program's record, of which a later version can have more fields: unknown ones are ignored. In
    what a user types (not `whole`) they are faults.

    A field is text, a flag, a number, a literal, null, a list, a tuple of equal entries, a dictionary with text as
    keys, or another dataclass with all its fields. Raises FreeArtError, which begins with `where`.
    """
    assert is_dataclass(kind)
    known = {field.name: field for field in fields(kind)}
    if not isinstance(data, dict):
        raise FreeArtError(f"{where} is {checked.shorten(data)}, expected an object of {', '.join(known)}")
    for name in data:
        if name not in known and not whole:
            raise FreeArtError(f"{where} has {checked.shorten(name)}, expected {', '.join(known)}")
    for name, field in known.items():
        if name not in data and field.default is MISSING and field.default_factory is MISSING:
            raise FreeArtError(f"{where} lacks '{name}', expected {', '.join(known)}")
    hints = get_type_hints(kind)
    return kind(
        **{
            name: _read_value(hints[name], value, f"{where}: '{name}'", whole)
            for name, value in data.items()
            if name in known
        }
    )


def _read_value(hint: Any, value: Any, where: str, whole: bool) -> Any:
    """`value` as the type `hint`; FreeArtError, which begins with `where`."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return None if value is None else _read_value(_not_none(inner), value, where, whole)
    if is_dataclass(hint):
        return read_record(hint, value, where, whole)  # type: ignore[arg-type]
    if origin is tuple and isinstance(value, list) and (inner[-1] is ... or len(value) == len(inner)):
        return tuple(_read_value(inner[0], entry, f"{where}, entry {k}", whole) for k, entry in enumerate(value))
    if origin is dict and isinstance(value, dict):
        return {
            key: _read_value(inner[1], entry, f"{where}: {checked.shorten(key)}", whole) for key, entry in value.items()
        }
    if hint is Any or (origin is Literal and value in inner):
        return value
    if hint is float and checked.is_number(value):
        return float(value)
    if hint in (str, bool, int) and type(value) is hint:
        return value
    raise FreeArtError(f"{where} is {checked.shorten(value)}, expected {_expected(hint)}")


def _not_none(hints: tuple[Any, ...]) -> Any:
    (hint,) = (hint for hint in hints if hint is not type(None))
    return hint


def _expected(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return ", ".join(map(str, inner))
    if origin is tuple:
        return f"a list{'' if inner[-1] is ... else f' of {len(inner)}'}, each {_expected(inner[0])}"
    return _WORDS.get(hint, "an object")
