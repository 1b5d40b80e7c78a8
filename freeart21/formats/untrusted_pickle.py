"""Reads numbers from an untrusted pickle without running anything that it names.

Unpickling calls functions that the file names, with arguments from the file. Here only NumPy's array storage is
accepted, and the classes below replace even that, so that no code of NumPy sees the file's state.
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
_CODES = {
    f"{kind}{size}" for kind, sizes in (("f", (2, 4, 8)), ("i", (1, 2, 4, 8)), ("u", (1, 2, 4, 8))) for size in sizes
}
_PLAIN = (str, int, float, bool, type(None))


class _Refused(Exception):
    """The file names or holds something other than numbers."""


class _Type:
    """Replaces numpy.dtype, for numbers only."""

    def __init__(self, code: str) -> None:
        if code not in _CODES:
            raise _Refused(f"an array of type {code!r}")
        self._code, self._order = code, "<"

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if len(state) < 5 or state[1] not in ("<", ">", "|", "=") or any(s is not None for s in state[2:5]):
            raise _Refused("a structured array")
        self._order = state[1]

    def read(self, raw: bytes) -> NDArray[Any]:
        return np.frombuffer(raw, np.dtype(self._order + self._code))


class _Array:
    """Replaces numpy.ndarray."""

    def __init__(self) -> None:
        self.value: NDArray[Any] | None = None

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        shape, kind, by_columns, raw = state[-4:]
        self.value = _shaped(raw, kind, shape, bool(by_columns))


def _shaped(raw: Any, kind: Any, shape: Any, by_columns: bool) -> NDArray[Any]:
    if not isinstance(kind, _Type) or not isinstance(raw, bytes | bytearray) or not isinstance(shape, tuple):
        raise _Refused("an array that is not numbers")
    if len(shape) > 4 or not all(type(n) is int and n >= 0 for n in shape):
        raise _Refused(f"an array of shape {shape!r}")
    values = kind.read(bytes(raw))
    if math.prod(shape) != len(values):
        raise _Refused(f"an array of shape {shape} with {len(values)} numbers")
    return values.reshape(shape, order="F" if by_columns else "C")


def _reconstruct(*_: Any) -> _Array:
    return _Array()


def _from_buffer(raw: Any, kind: Any, shape: Any, order: str) -> _Array:
    array = _Array()
    array.value = _shaped(raw, kind, shape, order == "F")
    return array


def _scalar(kind: Any, raw: Any) -> float:
    return float(_shaped(raw, kind, (1,), False)[0])


def _bytes(text: str, coding: str) -> bytes:
    if coding != "latin1":
        raise _Refused(f"text in {coding!r}")
    return text.encode("latin1")


_ADMITTED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): lambda code, *_: _Type(code),
    ("_codecs", "encode"): _bytes,
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _reconstruct for core in ("core", "_core")},
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
    if isinstance(value, _Array):
        if value.value is None:
            raise _Refused("an array without numbers")
        return value.value
    if type(value) in _PLAIN:
        return value
    if depth and type(value) is dict:
        return {_plain(k, 0, visited): _plain(v, depth - 1, visited) for k, v in value.items()}
    if depth and type(value) in (list, tuple):
        return [_plain(v, depth - 1, visited) for v in value]
    raise _Refused(f"a {type(value).__name__}" if depth else "lists in lists")
