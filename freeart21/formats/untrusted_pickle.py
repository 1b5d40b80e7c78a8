"""Reads numbers from an untrusted pickle without running anything that it names.

Unpickling calls functions that the file names, with arguments from the file. Here only NumPy's array storage is
accepted, and the records below take the place even of that: no code of NumPy sees the file's state before it is
checked.
"""

from __future__ import annotations

import io
import itertools
import math
import pickle
import pickletools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked

MAX_BYTES = 64 << 20
MAX_OPCODES = 1_000_000
_CODES = ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")


class _Refused(Exception):
    """The file names or holds something other than numbers."""


class _Record:
    """Stands for a dtype or an array: the arguments that made it, and its state, as they are in the file."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments, self.state = arguments, ()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.state = state


class _Dtype(_Record):
    """Stands for numpy.dtype."""


def _encode(text: str, coding: str) -> bytes:
    if coding != "latin1":
        raise _Refused(f"text in {coding!r}")
    return text.encode("latin1")


def _array(shape: Any, kind: Any, by_columns: Any, raw: Any) -> _Record:
    array = _Record()
    array.state = (shape, kind, by_columns, raw)
    return array


def _scalar(kind: Any, raw: Any) -> _Record:
    return _array((), kind, False, raw)


def _from_buffer(raw: Any, kind: Any, shape: Any, order: Any) -> _Record:
    return _array(shape, kind, order == "F", raw)


_ADMITTED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): _Dtype,
    ("_codecs", "encode"): _encode,
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _Record for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _scalar for core in ("core", "_core")},
    **{(f"numpy.{core}.numeric", "_frombuffer"): _from_buffer for core in ("core", "_core")},
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ADMITTED:
            raise _Refused(f"{module}.{name}")
        return _ADMITTED[module, name]


def read_pickle(path: Path) -> Any:
    """The dicts, lists, tuples, texts, numbers and NumPy arrays of numbers in a pickle of at most 64 MB.

    Raises FreeArtError when the file holds or names anything else; nothing that it names is imported.
    """
    data = checked.read_bytes(path, MAX_BYTES)
    try:
        for count, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            if count > MAX_OPCODES or (opcode.name.endswith("PUT") and int(argument or 0) > len(data)):
                raise _Refused("more than it could use")  # a memo of 2**32 entries takes all memory
        return _plain(_Unpickler(io.BytesIO(data)).load(), 4, itertools.count())
    except _Refused as refused:
        raise FreeArtError(f"{path} is refused: it holds {refused}, expected only numbers and NumPy arrays") from None
    except Exception as error:  # a file made to break the unpickler can raise anything
        raise FreeArtError(f"{path} is not a readable pickle: {type(error).__name__}") from None


def _plain(value: Any, depth: int, visited: Iterator[int]) -> Any:
    """`value` as plain types; the count of visits stops lists that contain one another many times."""
    if next(visited) > MAX_OPCODES:
        raise _Refused("more than it could use")
    if type(value) is _Record:
        return _numbers(*value.state[-4:])
    if value is None or type(value) in (str, int, float, bool):
        return value
    if depth and type(value) is dict:
        return {_plain(k, 0, visited): _plain(v, depth - 1, visited) for k, v in value.items()}
    if depth and type(value) in (list, tuple):
        return [_plain(v, depth - 1, visited) for v in value]
    raise _Refused(f"a {type(value).__name__}" if depth else "lists in lists")


def _numbers(shape: Any, kind: Any, by_columns: Any, raw: Any) -> NDArray[Any]:
    """The array of this state, a 0-dimensional one for a scalar."""
    if type(kind) is not _Dtype or kind.arguments[0] not in _CODES:
        raise _Refused(f"an array of type {kind.arguments[0]!r}" if type(kind) is _Dtype else "an array of no type")
    order = kind.state[1] if len(kind.state) > 1 else "<"
    if order not in ("<", ">", "|", "="):
        raise _Refused(f"numbers in the order {order!r}")
    if not isinstance(raw, bytes | bytearray):
        raise _Refused("an array that is not numbers")
    values = np.frombuffer(raw, np.dtype(order + kind.arguments[0]))
    if len(shape) > 4 or not all(type(n) is int and n >= 0 for n in shape) or math.prod(shape) != len(values):
        raise _Refused(f"an array of shape {shape!r} with {len(values)} numbers")
    return values.reshape(shape, order="F" if by_columns else "C")
