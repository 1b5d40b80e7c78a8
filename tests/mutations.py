"""Files that are nearly valid: one field dropped, of another type, of another size, or huge; and what readers owe them.

@MUTATED
@given(data=mutated_json(VALID))
def test_reader_reads_or_refuses(tmp_path, data):
    (tmp_path / "a.json").write_text(json.dumps(data))
    reads_or_refuses(read_a, tmp_path / "a.json")
"""

import copy
import csv
import io
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from freeart21.errors import FreeArtError

MUTATED = settings(
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
"""The settings of such a test; `settings(MUTATED, max_examples=20)` where a reader is slow."""

_ODD = (None, True, False, 0, -1, 1, 3, 10**400, 1e308, -1e308, float("nan"), float("inf"), 5e-324)
_ODD_ENTRIES = (*_ODD, "", "x", "1", "../..", "\x1b[31m\n", "y" * 5000, [], [[]], [1, "x"], {}, {"a": 1})
_CELLS = ("", "x", "nan", "inf", "-1", "0", "1e308", "1e999", '"', "\0", "1;2", "9" * 400)


def reads_or_refuses(call: Callable[..., Any], *arguments: Any, **named: Any) -> str:
    """Call it: it returns, or raises a FreeArtError of one printable line, which is returned ('' when it read)."""
    try:
        call(*arguments, **named)
    except FreeArtError as error:
        line = str(error)
        assert line.strip() and "\n" not in line, line
        return line
    return ""


@st.composite
def mutated_json(draw: st.DrawFn, value: Any) -> Any:
    """The JSON value with one entry, at any depth, dropped, repeated, or replaced by an odd one."""
    value = copy.deepcopy(value)
    path = draw(st.sampled_from(_paths(value)))
    if not path:
        return draw(st.sampled_from(_ODD_ENTRIES))
    parent = value
    for key in path[:-1]:
        parent = parent[key]
    key = path[-1]
    match draw(st.sampled_from(("drop", "replace", "replace", "wrap", "repeat", "rename"))):
        case "drop":
            del parent[key]
        case "replace":
            parent[key] = draw(st.sampled_from(_ODD_ENTRIES))
        case "wrap":
            parent[key] = [parent[key]]
        case "repeat" if isinstance(parent, list):
            parent.extend([copy.deepcopy(parent[key])] * draw(st.sampled_from((1, 50))))
        case "rename" if isinstance(parent, dict):
            parent[f"{key}_"] = parent.pop(key)
    return value


@st.composite
def mutated_arrays(draw: st.DrawFn, arrays: dict[str, Any]) -> dict[str, Any]:
    """The arrays of an .npz file with one dropped, or of another shape, type or content."""
    arrays = dict(arrays)
    name = draw(st.sampled_from(sorted(arrays)))
    array = np.asarray(arrays.pop(name))
    kinds = ("drop", "shorter", "longer", "empty", "flat", "axis", "scalar", "type", "text", "value")
    match draw(st.sampled_from(kinds)):
        case "shorter":
            arrays[name] = array[:-1] if array.ndim else array
        case "longer":
            arrays[name] = np.repeat(array, 2, 0) if array.ndim else np.stack([array] * 2)
        case "empty":
            arrays[name] = array[:0] if array.ndim else np.zeros(0)
        case "flat":
            arrays[name] = array.ravel()
        case "axis":
            arrays[name] = array[..., None]
        case "scalar":
            arrays[name] = np.float64(draw(st.sampled_from((0.0, np.nan))))
        case "type":
            kind = draw(st.sampled_from((bool, np.int8, np.float16, np.complex128)))
            with np.errstate(all="ignore"):
                arrays[name] = array.astype(kind) if array.dtype.kind in "biuf" else array
        case "text":
            arrays[name] = np.full(array.shape, "x")
        case "value" if array.size and array.dtype.kind == "f":
            array = array.copy()
            array.flat[draw(st.integers(0, array.size - 1))] = draw(st.sampled_from((np.nan, np.inf, -1e308, 1e30)))
            arrays[name] = array
    return arrays


@st.composite
def mutated_table(draw: st.DrawFn, text: str, delimiter: str = ",") -> str:
    """The CSV text with one cell, row or column dropped, repeated or replaced."""
    rows = list(csv.reader(io.StringIO(text), delimiter=delimiter))
    i = draw(st.sampled_from(sorted({0, 1, len(rows) // 2, len(rows) - 1})))
    j = draw(st.integers(0, len(rows[i]) - 1))
    match draw(st.sampled_from(("cell", "cell", "drop cell", "row", "repeat", "column", "cut"))):
        case "cell":
            rows[i][j] = draw(st.sampled_from(_CELLS))
        case "drop cell":
            del rows[i][j]
        case "row":
            del rows[i]
        case "repeat":
            rows.insert(i, list(rows[i]))
        case "column":
            rows = [row[:j] + row[j + 1 :] for row in rows]
        case "cut":
            rows = rows[:i]
    return "".join(delimiter.join(row) + "\n" for row in rows)


@st.composite
def mutated_bytes(draw: st.DrawFn, data: bytes) -> bytes:
    """The bytes of a file cut off, or with a few of them replaced; near the beginning as often as anywhere."""
    reach = draw(st.sampled_from((64, 1024, len(data))))
    at = draw(st.integers(0, min(reach, len(data)) - 1))
    if draw(st.booleans()):
        return data[:at]
    other = draw(st.sampled_from((b"\0", b"\xff", b"\xff\xff\xff\x7f", b"9999999", b"\n")))
    return data[:at] + other + data[at + len(other) :]


def _paths(value: Any) -> list[tuple[Any, ...]]:
    """The keys that lead to each entry of a JSON value; of a list the first, the last and a middle one."""
    found: list[tuple[Any, ...]] = [()]
    if isinstance(value, dict):
        keys: list[Any] = list(value)
    elif isinstance(value, list):
        keys = sorted({0, len(value) // 2, len(value) - 1}) if value else []
    else:
        keys = []
    for key in keys:
        found += [(key, *rest) for rest in _paths(value[key])]
    return found
