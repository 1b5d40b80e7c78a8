"""Reads time series from text (CSV and the like), JSON and MATLAB files: columns of numbers, their names and units.

    text   comma, semicolon, tab or spaces; decimal point or comma; the header in a line or a comment, or none; optional
           line of units after it; comments after # or %. Without a header the columns are called 1, 2, ...
    JSON   a list of objects (rows), an object of lists (columns), or a list of rows, at the top level or nested; of
           several the longest. Numbers of a list within a row are called NAME:1, NAME:2, ...
    MAT    version 5 to 7. Vectors are columns; columns of a matrix, along its longer side, are NAME:1, NAME:2, ...;
           fields of a structure are NAME.FIELD. A cell array (or an array of structures) has a run per cell.

Nothing in a file is executed, and sizes are bounded.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product, takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.run_table import MAX_CSV_BYTES, MAX_SAMPLES, shorten_line
from freeart21.formats.mat_file import MAX_MATRIX_COLUMNS, read_mat
from freeart21.formats.series_units import parse_unit, split_unit
from freeart21.se3 import Array

MAX_COLUMNS = 1000
_SAMPLE = 200
"""Lines at the end of a text that determine its separator, and which columns have numbers."""
_MAX_NAMES = 30
"""Most names in a message."""
_EMPTY = ["-", "na", "none", "null", "nan"]
"""Cells without a number, besides those that pandas knows."""
_BRACKET = re.compile(r"[\[(]([^\])]*)[\])]\s*$")
Columns = dict[str, tuple[Array, ...]]
"""Name to (n,) numbers per run; NaN for an empty cell."""


@dataclass(frozen=True)
class Series:
    """The columns of one file."""

    path: Path
    columns: Columns
    units: dict[str, str]
    """Name to the unit written in the file, in the words of `series_units`."""

    def column(self, name: str) -> tuple[Array, ...]:
        """The runs of a column, or of several columns whose names are joined by '+'."""
        return tuple(run for part in name.split("+") for run in self.columns[self.find_column(part.strip())])

    def find_column(self, name: str) -> str:
        """The column `name` as the file spells it, whatever the case; FreeArtError lists all columns."""
        for known in self.columns:
            if known.casefold() == name.casefold():
                return known
        raise FreeArtError(f"{self.path} has no column '{name}'; columns: {join_names(list(self.columns))}")


def join_names(names: list[str]) -> str:
    """At most _MAX_NAMES names, joined by commas."""
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    return (", ".join(names[:_MAX_NAMES]) or "none") + more


def read_series(path: Path) -> Series:
    """All columns of numbers in a text, JSON or MATLAB file. Raises FreeArtError."""
    path = Path(path)
    units: dict[str, str | None] = {}
    if path.suffix.lower() == ".mat":
        columns = read_mat(path)
    elif path.suffix.lower() == ".json":
        columns = _read_json(path)
    else:
        columns, units = _read_text(path)
    if not 1 <= len(columns) <= MAX_COLUMNS:
        raise FreeArtError(f"{path} has {len(columns)} columns of numbers, expected 1 to {MAX_COLUMNS}")
    longest = max(len(run) for runs in columns.values() for run in runs)
    if longest > MAX_SAMPLES:
        raise FreeArtError(f"{path} has {longest} rows, at most {MAX_SAMPLES} are read: thin them out")
    written = {name: unit for name in columns if (unit := units.get(name) or split_unit(name)[1])}
    return Series(path, columns, written)


def _read_text(path: Path) -> tuple[Columns, dict[str, str | None]]:
    """The columns of a text, and their units, in brackets after their names or in a line below."""
    data = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE)
    if b"\0" in data:
        raise FreeArtError(f"{path} is not text: it has NUL bytes; expected text (CSV), JSON or MAT")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    filled = [line for line in text.splitlines() if line.strip()]
    comments = [line.lstrip("#% \t") for line in takewhile(lambda line: line.lstrip()[:1] in ("#", "%"), filled)]
    lines = [line for line in filled if line.lstrip()[:1] not in ("#", "%")]
    if not lines:
        raise FreeArtError(f"{path} has no rows")
    try:
        separator, decimal = max(product(",;\t ", ".,"), key=lambda way: _fit_score(lines[-_SAMPLE:], *way))
        above = [cells for line in comments[-1:] for cells in [_split(line, separator)]]
        sample = [_split(line, separator) for line in lines[-_SAMPLE:]]
        width = Counter(map(len, sample)).most_common(1)[0][0]
        sample = [cells for cells in sample if len(cells) == width]
        numeric = [k for k in range(width) if 2 * sum(_is_number(row[k], decimal) for row in sample) > len(sample)]
        first = 0
        while first < len(lines) and not _is_data(cells := _split(lines[first], separator), width, numeric, decimal):
            above.append(cells)
            first += 1
        if first == len(lines):
            raise FreeArtError(f"{path} has no rows of numbers; it begins with '{shorten_line(lines[0], 60)}'")
        table = pd.read_csv(
            io.StringIO("\n".join(lines[first:])),
            sep=r"\s+" if separator == " " else separator,
            decimal=decimal,
            header=None,
            skipinitialspace=True,
            na_values=_EMPTY,
            float_precision="round_trip",
        )
    except (csv.Error, pd.errors.ParserError) as error:
        raise FreeArtError(f"{path} is not CSV: {shorten_line(str(error), 200)}") from error
    above = [cells for cells in above if len(cells) == width]
    units_row = above.pop() if len(above) > 1 and all(parse_unit(cell) for cell in above[-1] if cell) else [""] * width
    names: list[str] = []
    units = {}
    for k, (cell, unit) in enumerate(zip(above[-1] if above else [""] * width, units_row, strict=True)):
        bracket = _BRACKET.search(cell)
        if bracket and parse_unit(bracket[1]):
            cell, unit = cell[: bracket.start()], bracket[1]
        name = " ".join(cell.split()) or str(k + 1)
        names.append(name if name not in names else f"{name}:{k + 1}")
        units[names[-1]] = parse_unit(unit)
    return _number_columns(table.set_axis(names, axis=1)), units


def _split(line: str, separator: str) -> list[str]:
    """The cells of a line."""
    if separator == " ":
        return line.split()
    return [cell.strip() for row in csv.reader([line], delimiter=separator, skipinitialspace=True) for cell in row]


def _is_number(cell: str, decimal: str) -> bool:
    """Whether a cell holds a number, or nothing."""
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return cell.casefold() in ("", "true", "false", *_EMPTY)
    return True


def _is_data(cells: list[str], width: int, numeric: list[int], decimal: str) -> bool:
    """Whether a row of `width` cells has numbers in the `numeric` columns, one at least."""
    return (
        len(cells) == width and all(_is_number(cells[k], decimal) for k in numeric) and any(cells[k] for k in numeric)
    )


def _fit_score(lines: list[str], separator: str, decimal: str) -> tuple[float, int]:
    """Score of a separator: the share of numeric cells, then their number."""
    cells = [] if decimal == separator else [cell for line in lines for cell in _split(line, separator)]
    numbers = sum(_is_number(cell, decimal) for cell in cells)
    return numbers / max(1, len(cells)), numbers


def _number_columns(table: pd.DataFrame) -> Columns:
    """The columns of numbers; of ISO dates and times as seconds from the first; and of lists, an entry each."""
    columns: Columns = {}
    for name, values in table.items():
        inner = values[[isinstance(value, list) for value in values]]
        if len(inner):
            most = min(int(inner.map(len).max()), MAX_MATRIX_COLUMNS)
            entries = {f"{name}:{k + 1}": values.str[k] for k in range(most)}
            columns |= _number_columns(pd.DataFrame(entries))
            continue
        numbers = pd.to_numeric(values, errors="coerce").astype(float)
        if 2 * (numbers.isna() & values.notna()).sum() > len(values):
            stamps = pd.to_datetime(values, format="ISO8601", errors="coerce", utc=True)
            if stamps.isna().iloc[-1]:
                continue
            numbers = (stamps - stamps.dropna().iloc[0]).dt.total_seconds()
        columns[str(name)] = (np.ascontiguousarray(numbers, float),)
    return columns


def _read_json(path: Path) -> Columns:
    """The longest table in a JSON file."""
    try:
        text = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{path} is not JSON: {error}") from error
    tables = list(_tables(checked.parse_json(text, path), 3))
    if not tables:
        raise FreeArtError(f"{path} has no table: expected a list of objects, an object of lists, or a list of rows")
    return _number_columns(max(tables, key=len))


def _tables(data: Any, depth: int) -> Iterator[pd.DataFrame]:
    """All tables in a JSON value."""
    if isinstance(data, list) and len(data) > 1 and all(isinstance(row, dict | list) for row in data):
        table = pd.DataFrame(data)
        yield table if isinstance(data[0], dict) else table.rename(columns=lambda k: str(k + 1))
    elif isinstance(data, dict):
        lists = {
            k: v for k, v in data.items() if isinstance(v, list) and len(v) > 1 and not isinstance(v[0], dict | list)
        }
        length = Counter(map(len, lists.values())).most_common(1)[0][0] if lists else 0
        yield pd.DataFrame({key: value for key, value in lists.items() if len(value) == length})
        for value in list(data.values())[: MAX_COLUMNS if depth else 0]:
            yield from _tables(value, depth - 1)
