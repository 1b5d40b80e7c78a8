"""Reads time series from text (CSV and the like), JSON and MATLAB files: columns of numbers and their names.

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
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.run_table import MAX_CSV_BYTES, MAX_SAMPLES, shorten_line
from freeart21.formats.mat_file import MAX_MATRIX_COLUMNS, read_mat
from freeart21.se3 import Array

MAX_COLUMNS = 1000
_SAMPLE = 200
"""Lines at the end of a text that determine its separator."""
_MOST_ODD = 0.01
"""Largest share of lines with another number of cells in a table."""
_MAX_NAMES = 30
"""Most names in a message."""
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "white space"}
_UNIT = re.compile(r"[\[(]([^\])]*)[\])]\s*$")
_UNIT_WORDS = (
    "s sec seconds ms us ns rad radians deg degrees ° turns m mm cm n*m n.m nm mnm n rad/s deg/s °/s m/s mm/s rpm v a "
    "ma -"
)
_UNITS = frozenset(_UNIT_WORDS.split())
Columns = dict[str, tuple[Array, ...]]
"""Name to (n,) numbers per run."""


@dataclass(frozen=True)
class Series:
    """The columns of one file."""

    path: Path
    columns: Columns
    """Name to (n,) numbers per run in the file; NaN for an empty cell."""
    units: dict[str, str]
    """Name to the unit written in the file."""
    notes: tuple[str, ...]
    """How the file was read, one line each."""

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
    series = {".mat": _read_mat, ".json": _read_json}.get(path.suffix.lower(), _read_text)(path)
    if not 1 <= len(series.columns) <= MAX_COLUMNS:
        raise FreeArtError(f"{path} has {len(series.columns)} columns of numbers, expected 1 to {MAX_COLUMNS}")
    longest = max(len(run) for runs in series.columns.values() for run in runs)
    if longest > MAX_SAMPLES:
        raise FreeArtError(f"{path} has {longest} rows, at most {MAX_SAMPLES} are read: thin them out")
    return series


# text


def _read_text(path: Path) -> Series:
    data = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE)
    if b"\0" in data[: 1 << 20]:
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
        dialect = max(product(_SEPARATORS, ".,"), key=lambda one: _fit_score(_split(lines[-_SAMPLE:], *one)))
        rows, header = _split(lines, *dialect), _split(comments[-1:], *dialect)
    except csv.Error as error:
        raise FreeArtError(f"{path} is not CSV: {error}") from error
    width = _width(rows[-_SAMPLE:])
    full = [i for i, row in enumerate(rows) if len(row) == width]
    values, known = _parse_cells([rows[i] for i in full])
    numeric = known[-_SAMPLE:].mean(0) > 0.5
    is_data = known[:, numeric].all(1) & ~np.isnan(values[:, numeric]).all(1)
    if not is_data.any():
        raise FreeArtError(f"{path} has no rows of numbers; it begins with '{shorten_line(lines[0], 60)}'")
    first = int(np.argmax(is_data))
    odd = len(rows) - full[first] - (len(full) - first)
    if odd > max(1, _MOST_ODD * len(rows)):
        raise FreeArtError(f"{path}: {odd} of {len(rows) - full[first]} rows have another number of cells than {width}")
    above = [row for row in header if len(row) == width] + [rows[i] for i in full[:first]]
    units_row = above.pop() if len(above) > 1 and all(map(_is_unit, above[-1])) else [""] * width
    names, units = _names(above[-1] if above else [""] * width, units_row)
    columns: Columns = {}
    for k, name in enumerate(names):
        if numeric[k]:
            columns[name] = (np.ascontiguousarray(values[first:, k]),)
        elif (seconds := _seconds([rows[i][k] for i in full[first:]])) is not None:
            columns[name], units[name] = (seconds,), "s"
    strange = int((~known[first:, numeric]).sum())
    how = _SEPARATORS[dialect[0]] + (", decimal commas" if dialect[1] == "," else "")
    called = f"{'header' if above else 'no header: columns are called'} {join_names(names)}"
    notes = [f"{len(full) - first} rows, separated by {how}; {called}"]
    notes += [f"{odd} rows with another number of cells than {width} were left out"] if odd else []
    notes += [f"{strange} cells without a number were taken as empty"] if strange else []
    return Series(path, columns, units, tuple(notes))


def _split(lines: list[str], separator: str, decimal: str) -> list[list[str]]:
    """The cells of each line, with decimal points."""
    rows = csv.reader(lines, delimiter=separator) if separator != " " else map(str.split, lines)
    if decimal == ",":
        rows = [[cell.replace(",", ".") for cell in row] for row in rows] if separator != "," else []
    return [[cell.strip() for cell in row] for row in rows]


def _width(rows: list[list[str]]) -> int:
    """The most common number of cells."""
    return Counter(map(len, rows)).most_common(1)[0][0] if rows else 0


def _fit_score(rows: list[list[str]]) -> tuple[float, int]:
    """Score of a separator: the share of numeric cells, then the number of cells per row."""
    width = _width(rows)
    numbers = sum(_parse_number(cell) is not None for row in rows if len(row) == width for cell in row)
    return numbers / max(1, sum(map(len, rows))), width


def _parse_cells(rows: list[list[str]]) -> tuple[Array, NDArray[np.bool_]]:
    """(n, k) numbers, NaN where a cell is empty or no number, and whether it is a number or empty."""
    parsed = [[_parse_number(cell) for cell in row] for row in rows]
    return np.array(parsed, float), np.array([[value is not None for value in row] for row in parsed])


def _parse_number(cell: str) -> float | None:
    """The number in a cell: NaN when it is empty, None when it is something else."""
    if not cell or cell.casefold() in ("na", "null", "none", "-"):
        return np.nan
    if cell.casefold() in ("true", "false"):
        return float(cell.casefold() == "true")
    try:
        return float(cell)
    except ValueError:
        return None


def _seconds(cells: list[str]) -> Array | None:
    """ISO dates and times as seconds from the first; None when the last cell is none."""
    import pandas as pd

    stamps = pd.to_datetime(pd.Series(cells), format="ISO8601", errors="coerce", utc=True)
    if stamps.isna().iloc[-1]:
        return None
    return np.asarray((stamps - stamps.dropna().iloc[0]).dt.total_seconds(), float)


def _is_unit(cell: str) -> bool:
    bare = cell.strip("[]() ").casefold()
    return bare in _UNITS or not bare


def _names(header: list[str], units_row: list[str]) -> tuple[list[str], dict[str, str]]:
    """Unique names of the columns, and their units, written in brackets after them or in a row below."""
    names: list[str] = []
    units = {}
    for k, (cell, unit) in enumerate(zip(header, units_row, strict=True)):
        bracket = _UNIT.search(cell)
        if bracket and _is_unit(bracket[1]):
            cell, unit = cell[: bracket.start()], bracket[1]
        name = " ".join(cell.split()) or str(k + 1)
        names.append(name if name not in names else f"{name}:{k + 1}")
        if bare := unit.strip("[]() "):
            units[names[-1]] = bare
    return names, units


# JSON


def _read_json(path: Path) -> Series:
    try:
        text = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{path} is not JSON: {error}") from error
    tables = list(_tables(checked.parse_json(text, path), "", 3))
    if not tables:
        raise FreeArtError(f"{path} has no table: expected a list of objects, an object of lists, or a list of rows")
    where, rows, columns = max(tables, key=lambda table: table[1])
    note = f"{rows} rows{f' of {where!r}' if where else ''}; columns {join_names(list(columns))}"
    return Series(path, columns, {}, (note,))


def _tables(data: Any, where: str, depth: int) -> Iterator[tuple[str, int, Columns]]:
    """All tables in a JSON value: path, number of rows, columns."""
    if isinstance(data, list) and len(data) > 1 and all(isinstance(row, dict | list) for row in data):
        cells = [_cells(row) for row in data]
        names = list(dict.fromkeys(name for row in cells for name in row))[: MAX_COLUMNS + 1]
        if names:
            yield where, len(data), {name: (np.array([row.get(name, np.nan) for row in cells]),) for name in names}
    elif isinstance(data, dict):
        lists = {key: v for key, v in data.items() if isinstance(v, list) and v and all(map(_is_number, v))}
        length = Counter(map(len, lists.values())).most_common(1)[0][0] if lists else 0
        if length > 1:
            yield where, length, {key: (np.array(v, float),) for key, v in lists.items() if len(v) == length}
        for key, value in list(data.items())[: MAX_COLUMNS if depth else 0]:
            yield from _tables(value, f"{where}.{key}".strip("."), depth - 1)


def _cells(row: dict[str, Any] | list[Any]) -> dict[str, float]:
    """Name to number of one row; numbers of a list within it have a name each."""
    cells: dict[str, float] = {}
    for name, value in row.items() if isinstance(row, dict) else ((str(k + 1), v) for k, v in enumerate(row)):
        inner = value if isinstance(value, list) and len(value) <= MAX_MATRIX_COLUMNS else []
        cells |= {f"{name}:{k + 1}": float(v) for k, v in enumerate(inner) if _is_number(v) and v is not None}
        if _is_number(value):
            cells[name] = np.nan if value is None else float(value)
    return cells


def _is_number(value: Any) -> bool:
    return value is None or isinstance(value, bool | float) or (isinstance(value, int) and abs(value) < 1e30)


# MATLAB


def _read_mat(path: Path) -> Series:
    columns = read_mat(path)
    sizes = [f"{name} ({f'{len(runs)} runs' if len(runs) > 1 else len(runs[0])})" for name, runs in columns.items()]
    return Series(path, columns, {}, (f"MAT file; columns {join_names(sizes)}",))
