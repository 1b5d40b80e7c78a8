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
import io
import re
from collections import Counter
from dataclasses import dataclass
from datetime import datetime
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

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


@dataclass(frozen=True)
class Series:
    """The columns of one file."""

    path: Path
    columns: dict[str, tuple[Array, ...]]
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
            if known == name or known.casefold() == name.casefold():
                return known
        raise FreeArtError(f"{self.path} has no column '{name}'; columns: {join_names(list(self.columns))}")


def join_names(names: list[str]) -> str:
    """At most _MAX_NAMES names, joined by commas."""
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    return (", ".join(names[:_MAX_NAMES]) or "none") + more


def read_series(path: Path) -> Series:
    """All columns of numbers in a text, JSON or MATLAB file. Raises FreeArtError."""
    path = Path(path)
    if path.suffix.lower() in (".xls", ".xlsx", ".ods", ".npz", ".npy", ".pkl", ".bag", ".h5", ".hdf5", ".parquet"):
        raise FreeArtError(f"{path} is a {path.suffix} file, expected text (CSV), JSON or MAT: save it as CSV")
    reader = {".mat": _read_mat, ".json": _read_json}.get(path.suffix.lower(), _read_text)
    series = reader(path)
    if not series.columns:
        raise FreeArtError(f"{path} has no columns of numbers")
    if len(series.columns) > MAX_COLUMNS:
        raise FreeArtError(f"{path} has {len(series.columns)} columns, at most {MAX_COLUMNS} are read")
    longest = max(len(run) for runs in series.columns.values() for run in runs)
    if longest > MAX_SAMPLES:
        raise FreeArtError(f"{path} has {longest} rows, at most {MAX_SAMPLES} are read: thin them out")
    return series


def parse_number(cell: str) -> float | None:
    """The number in a cell: NaN when it is empty, None when it is something else."""
    cell = cell.strip()
    if not cell or cell.casefold() in ("nan", "na", "null", "none", "-"):
        return np.nan
    if cell.casefold() in ("true", "false"):
        return float(cell.casefold() == "true")
    try:
        return float(cell)
    except ValueError:
        return None


# text


@dataclass(frozen=True)
class _Dialect:
    delimiter: str | None
    """None for white space."""
    decimal: str

    def rows(self, lines: list[str]) -> list[list[str]]:
        if self.delimiter is None:
            rows = [line.split() for line in lines]
        else:
            rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=self.delimiter))
        if self.decimal == ",":
            rows = [[cell.replace(",", ".") for cell in row] for row in rows]
        return [[cell.strip() for cell in row] for row in rows]

    def __str__(self) -> str:
        name = {None: "white space", "\t": "tabs", ";": "semicolons", ",": "commas"}[self.delimiter]
        return name + (", decimal commas" if self.decimal == "," else "")


_DIALECTS = (
    _Dialect(",", "."),
    _Dialect(";", "."),
    _Dialect("\t", "."),
    _Dialect(None, "."),
    _Dialect(";", ","),
    _Dialect("\t", ","),
    _Dialect(None, ","),
)


def _read_text(path: Path) -> Series:
    data = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE)
    if b"\0" in data[: 1 << 20]:
        raise FreeArtError(f"{path} is not text: it has NUL bytes")
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
        dialect = max(_DIALECTS, key=lambda d: _fit_score(d.rows(lines[-_SAMPLE:])))
        rows = dialect.rows(lines)
        header = dialect.rows(comments[-1:])
    except csv.Error as error:
        raise FreeArtError(f"{path} is not CSV: {error}") from error
    width = Counter(len(row) for row in rows[-_SAMPLE:]).most_common(1)[0][0]
    numeric = [k for k in range(width) if _is_number(rows[-_SAMPLE:], k, width)]
    stamps = [k for k in range(width) if k not in numeric and _is_stamp(rows[-1], k)]
    first = next((i for i, row in enumerate(rows) if _is_data(row, numeric, width)), len(rows))
    if not numeric or first == len(rows):
        raise FreeArtError(f"{path} has no rows of numbers; it begins with '{shorten_line(lines[0], 60)}'")
    above = [row for row in [*header, *rows[:first]] if len(row) == width]
    units_row = len(above) > 1 and all(_is_unit(cell) for cell in above[-1])
    named = above[-2 if units_row else -1] if above else []
    names, units = _names(named, above[-1] if units_row else None, width)
    good = [row for row in rows[first:] if len(row) == width]
    odd = len(rows) - first - len(good)
    if odd > max(1, _MOST_ODD * len(rows)):
        raise FreeArtError(f"{path}: {odd} of {len(rows) - first} rows have another number of cells than {width}")
    columns: dict[str, tuple[Array, ...]] = {}
    strange = 0
    for k in range(width):
        if k in numeric:
            values = [parse_number(row[k]) for row in good]
            strange += sum(value is None for value in values)
            columns[names[k]] = (np.array([np.nan if value is None else value for value in values]),)
        elif k in stamps:
            columns[names[k]], units[names[k]] = (_stamps([row[k] for row in good]),), "s"
    called = f"header {join_names(names)}" if named else "no header: columns are called " + join_names(names)
    notes = [f"{len(good)} rows, separated by {dialect}; {called}"]
    notes += [f"{odd} rows with another number of cells than {width} were left out"] if odd else []
    notes += [f"{strange} cells without a number were taken as empty"] if strange else []
    return Series(path, columns, units, tuple(notes))


def _fit_score(rows: list[list[str]]) -> tuple[float, int]:
    """Score of a separator: the share of numeric cells, then the number of cells per row."""
    width = Counter(len(row) for row in rows).most_common(1)[0][0]
    same = [cell for row in rows if len(row) == width for cell in row]
    numbers = sum(parse_number(cell) is not None for cell in same)
    return numbers / max(1, sum(map(len, rows))), width


def _is_number(rows: list[list[str]], k: int, width: int) -> bool:
    values = [parse_number(row[k]) for row in rows if len(row) == width]
    return 2 * sum(value is not None for value in values) > len(values)


def _is_data(row: list[str], numeric: list[int], width: int) -> bool:
    values = [parse_number(row[k]) for k in numeric] if len(row) == width else []
    return bool(values) and None not in values and not all(np.isnan(value or 0.0) for value in values)


def _stamp(cell: str) -> datetime | None:
    try:
        return datetime.fromisoformat(cell.strip().replace("Z", "+00:00"))
    except ValueError:
        return None


def _is_stamp(row: list[str], k: int) -> bool:
    return k < len(row) and _stamp(row[k]) is not None


def _stamps(cells: list[str]) -> Array:
    """ISO dates and times as seconds from the first."""
    stamps = [_stamp(cell) for cell in cells]
    first = next(stamp for stamp in stamps if stamp is not None)
    return np.array([np.nan if stamp is None else (stamp - first).total_seconds() for stamp in stamps])


_UNIT = re.compile(r"[\[(]([^\])]*)[\])]\s*$")
_MORE_UNITS = "rad radians deg degrees ° turns m mm cm n*m n.m nm mnm n rad/s deg/s °/s m/s mm/s rpm v a ma -"
_UNITS = frozenset(["s", "sec", "seconds", "ms", "us", "ns", *_MORE_UNITS.split()])


def _is_unit(cell: str) -> bool:
    bare = cell.strip().strip("[]()").casefold()
    return bare in _UNITS or not bare


def _names(header: list[str], units_row: list[str] | None, width: int) -> tuple[list[str], dict[str, str]]:
    """Unique names of the columns, and their units, written in brackets after them or in a row below."""
    names, units = [], {}
    for k in range(width):
        cell = header[k] if header else ""
        unit = units_row[k].strip("[]() ") if units_row else ""
        bracket = _UNIT.search(cell)
        if bracket and _is_unit(bracket[1]):
            cell, unit = cell[: bracket.start()], bracket[1]
        name = " ".join(cell.split()) or str(k + 1)
        name = name if name not in names else f"{name}:{k + 1}"
        names.append(name)
        if unit:
            units[name] = unit
    return names, units


# JSON


def _read_json(path: Path) -> Series:
    try:
        text = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{path} is not JSON: {error}") from error
    tables = sorted(_tables(checked.parse_json(text, path), "", 3), key=lambda found: -found[1])
    if not tables:
        raise FreeArtError(f"{path} has no table: expected a list of objects, an object of lists, or a list of rows")
    where, rows, columns = tables[0]
    note = f"{rows} rows{f' of {where!r}' if where else ''}; columns {join_names(list(columns))}"
    return Series(path, columns, {}, (note,))


def _tables(data: Any, where: str, depth: int) -> list[tuple[str, int, dict[str, tuple[Array, ...]]]]:
    """All tables in a JSON value: path, number of rows, columns."""
    found: list[tuple[str, int, dict[str, tuple[Array, ...]]]] = []
    if isinstance(data, list) and len(data) > 1 and all(isinstance(row, dict | list) for row in data):
        cells = [_cells(row) for row in data]
        names = list(dict.fromkeys(name for row in cells for name in row))[: MAX_COLUMNS + 1]
        columns: dict[str, tuple[Array, ...]] = {n: (np.array([row.get(n, np.nan) for row in cells]),) for n in names}
        if columns:
            found.append((where, len(data), columns))
    elif isinstance(data, dict):
        lists = {str(k): v for k, v in data.items() if isinstance(v, list) and v and all(map(_is_json_number, v))}
        length = Counter(map(len, lists.values())).most_common(1)[0][0] if lists else 0
        if length > 1:
            same: dict[str, tuple[Array, ...]] = {
                k: (np.array(v, float),) for k, v in lists.items() if len(v) == length
            }
            found.append((where, length, same))
        if depth:
            for key, value in list(data.items())[:MAX_COLUMNS]:
                found += _tables(value, f"{where}.{key}".strip("."), depth - 1)
    return found


def _cells(row: dict[str, Any] | list[Any]) -> dict[str, float]:
    pairs = row.items() if isinstance(row, dict) else ((str(k + 1), v) for k, v in enumerate(row))
    cells: dict[str, float] = {}
    for name, value in pairs:
        if isinstance(value, list) and len(value) <= MAX_MATRIX_COLUMNS:
            cells |= {f"{name}:{k + 1}": float(v) for k, v in enumerate(value) if _is_json_number(v) and v is not None}
        elif _is_json_number(value):
            cells[str(name)] = np.nan if value is None else float(value)
    return cells


def _is_json_number(value: Any) -> bool:
    return value is None or isinstance(value, bool | float) or (isinstance(value, int) and abs(value) < 1e30)


# MATLAB


def _read_mat(path: Path) -> Series:
    columns = read_mat(path)
    sizes = [f"{name} ({_size(runs)})" for name, runs in columns.items()]
    return Series(path, columns, {}, (f"MAT file; columns {join_names(sizes)}",))


def _size(runs: tuple[Array, ...]) -> str:
    return f"{len(runs)} runs" if len(runs) > 1 else str(len(runs[0]))
