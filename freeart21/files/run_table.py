"""The table of a run: a CSV file of numbers, read at once where it is plain, and row by row to say what is wrong."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.se3 import Array

MAX_CSV_BYTES = 64 << 20
MAX_SAMPLES = 1_000_000
"""Of a run."""


def read_table(file: Path, columns: Sequence[str]) -> tuple[dict[str, Array], list[int]]:
    """Column name to (n,) numbers, and the line of each; an empty cell is NaN.

    Raises FreeArtError when it is no table of numbers with `t_s` and `q`, and else of these columns.
    """
    if file.is_dir():
        raise FreeArtError(f"{file} is a folder, expected a CSV file; a folder with poses.npz is of kind 'poses'")
    try:
        text = checked.require_file(file, MAX_CSV_BYTES).read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{file} is not text: {error}") from error
    if "\0" in text:
        raise FreeArtError(
            f"{file} is not text: it has a NUL byte in line {text[: text.index(chr(0))].count(chr(10)) + 1}"
        )
    fast = _fast_table(text)
    if fast is not None:
        return _named(file, *fast, columns), list(range(2, len(fast[1]) + 2))
    reader = csv.reader(io.StringIO(text))
    try:
        numbered = [(reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise FreeArtError(f"{file} line {reader.line_num} is not CSV: {error}") from error
    header = [cell.strip() for cell in numbered[0][1]] if numbered else []
    _named(file, header, np.empty((max(len(numbered) - 1, 0), len(header))), columns)
    values = np.empty((len(numbered) - 1, len(header)))
    for i, (line, row) in enumerate(numbered[1:]):
        try:
            values[i] = [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError as error:
            raise FreeArtError(
                f"{file} line {line} is '{short(','.join(row))}', expected {len(header)} numbers"
            ) from error
    return _named(file, header, values, columns), [line for line, _ in numbered[1:]]


def _fast_table(text: str) -> tuple[list[str], Array] | None:
    """Header and (n, c) numbers of a plain table, read at once; None when it is not plain, or has a fault."""
    first, _, rest = text.partition("\n")
    if '"' in text or "\r" in text.replace("\r\n", "") or "#" in text or not rest.strip():
        return None
    rest = _EMPTY.sub("nan", rest.replace("\r\n", "\n").rstrip("\n"))
    if "\n\n" in rest or rest.startswith("\n"):
        return None
    header = [cell.strip() for cell in first.strip().split(",")]
    letters = np.frombuffer(rest.encode() + b"\n", np.uint8)
    ends = np.flatnonzero(letters == ord("\n"))
    if (np.diff(np.cumsum(letters == ord(","))[ends], prepend=0) != len(header) - 1).any():
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            values = np.fromstring(rest.replace("\n", ","), sep=",")
        except (ValueError, DeprecationWarning):  # something that is no number
            return None
    if len(values) != len(ends) * len(header) or np.isinf(values).any():
        return None
    return header, values.reshape(len(ends), len(header))


_EMPTY = re.compile(r"(?m)(?<=,)(?=[ \t]*(?:,|$))|^(?=[ \t]*,)")
"""A cell in which nothing stands."""


def _named(file: Path, header: list[str], values: Array, columns: Sequence[str]) -> dict[str, Array]:
    """Column name to its numbers, of columns that a run may have."""
    for column in ("t_s", "q"):
        if column not in header:
            raise FreeArtError(f"{file} has no column '{column}'; its columns: {short(', '.join(header)) or 'none'}")
    unknown = [column for column in header if column not in columns]
    if unknown or len(set(header)) != len(header):
        raise FreeArtError(f"{file} has columns {short(', '.join(header))}; expected each once of {', '.join(columns)}")
    if len(values) > MAX_SAMPLES:
        raise FreeArtError(f"{file} has {len(values)} samples, at most {MAX_SAMPLES} are read: thin them out")
    return {column: np.ascontiguousarray(values[:, i]) for i, column in enumerate(header)}


def short(text: str, most: int = 80) -> str:
    """The text on one line, and not much of it."""
    text = " ".join(text.split())
    return text if len(text) <= most else text[:most] + "..."
