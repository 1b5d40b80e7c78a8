"""Reads the table of a run: a CSV file of numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.se3 import Array

MAX_CSV_BYTES = 64 << 20
MAX_SAMPLES = 1_000_000
"""Most rows of a run."""


def read_table(file: Path, columns: Sequence[str]) -> tuple[dict[str, Array], list[int]]:
    """Column name to (n,) numbers, and the line of each; an empty cell is NaN.

    Raises FreeArtError unless it is a table of numbers with `t_s`, `q` and other `columns` only.
    """
    if file.is_dir():
        raise FreeArtError(f"{file} is a folder, expected a CSV file; a folder with poses.npz is of kind 'poses'")
    text = checked.read_text(file, MAX_CSV_BYTES, encoding="utf-8-sig")
    if "\0" in text:
        raise FreeArtError(
            f"{file} is not text: it has a NUL byte in line {text[: text.index(chr(0))].count(chr(10)) + 1}"
        )
    reader = csv.reader(io.StringIO(text))
    try:
        numbered = [(reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        raise FreeArtError(f"{file} line {reader.line_num} is not CSV: {error}") from error
    header = [cell.strip() for cell in numbered[0][1]] if numbered else []
    _check_header(file, header, len(numbered) - 1, columns)
    values = np.empty((len(numbered) - 1, len(header)))
    for i, (line, row) in enumerate(numbered[1:]):
        try:
            values[i] = [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError as error:
            raise FreeArtError(
                f"{file} line {line} is '{shorten_line(','.join(row))}', expected {len(header)} numbers"
            ) from error
    table = {column: np.ascontiguousarray(values[:, i]) for i, column in enumerate(header)}
    return table, [line for line, _ in numbered[1:]]


def _check_header(file: Path, header: list[str], rows: int, columns: Sequence[str]) -> None:
    for column in ("t_s", "q"):
        if column not in header:
            raise FreeArtError(
                f"{file} has no column '{column}'; its columns: {shorten_line(', '.join(header)) or 'none'}"
            )
    unknown = [column for column in header if column not in columns]
    if unknown or len(set(header)) != len(header):
        raise FreeArtError(
            f"{file} has columns {shorten_line(', '.join(header))}; expected each once of {', '.join(columns)}"
        )
    if rows > MAX_SAMPLES:
        raise FreeArtError(f"{file} has {rows} samples, at most {MAX_SAMPLES} are read: thin them out")


def shorten_line(text: str, most: int = 80) -> str:
    """The first `most` characters of a text, on one line."""
    text = " ".join(text.split())
    return text if len(text) <= most else text[:most] + "..."
