"""Columns of numbers in a MATLAB file of version 4 to 7.

SciPy's reader crashes on some broken files, and unpacks others to any size, so it runs in a process of its own with
bounded memory.
"""

from __future__ import annotations

import io
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.run_table import MAX_CSV_BYTES
from freeart21.se3 import Array

MAX_MATRIX_COLUMNS = 64
"""A matrix with more columns is not read."""
MAX_CELLS = 1000
"""Most cells, a run each: known recordings have at most six."""
MAX_MEMORY = 4 << 30
"""Of the reader's process, bytes: SciPy and the largest measured set, 256 MB, four times."""
TIME_LIMIT_S = 120.0
"""The largest file, 64 MB, takes some 2 s."""


def read_mat(path: Path) -> dict[str, tuple[Array, ...]]:
    """Column name to (n,) numbers per run, named as in `time_series`. Raises FreeArtError."""
    data = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE)
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "columns.npz"
        command = [*processes.command("freeart21.formats.mat_file"), str(out), str(MAX_MEMORY)]
        try:
            done = subprocess.run(command, input=data, capture_output=True, timeout=TIME_LIMIT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise FreeArtError(f"{path} was not read within {TIME_LIMIT_S:g} s") from error
        if done.returncode or not out.is_file():
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            reason = " ".join(lines[-1].split())[:120] if done.returncode == 1 and lines else "the reader crashed on it"
            raise FreeArtError(f"{path} is not a readable MAT file: {reason}")
        arrays = checked.read_npz(out)
    columns: dict[str, tuple[Array, ...]] = {}
    for k, name in enumerate(arrays.pop("names").tolist()):  # a column with several runs is there several times
        columns[name] = (*columns.get(name, ()), arrays[str(k)])
    return columns


def main() -> None:
    """Read MAT bytes on standard input; write the names and runs of all columns to an .npz."""
    from scipy.io import loadmat

    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
    columns: dict[str, tuple[Array, ...]] = {}
    try:
        for name, value in loadmat(io.BytesIO(sys.stdin.buffer.read())).items():
            if not name.startswith("__"):
                columns |= _flat(name, value, 3)
    except NotImplementedError:
        sys.exit("version 7.3 (HDF5): save it by save(..., '-v7')")
    except Exception as error:
        sys.exit(str(error) or type(error).__name__)
    runs = [(name, run) for name, own in columns.items() for run in own]
    named: dict[str, Any] = {str(k): run for k, (_, run) in enumerate(runs)}
    np.savez(sys.argv[1], names=np.array([name for name, _ in runs], str), **named)


def _flat(name: str, value: Any, depth: int) -> dict[str, tuple[Array, ...]]:
    """A variable as columns; what is no series of numbers is left out."""
    value = np.asarray(value)
    if value.dtype.names or value.dtype == object:  # structures, or cells with a run in each
        if not depth or not 1 <= value.size <= MAX_CELLS:
            return {}
        if value.dtype.names:
            inner = {f"{name}.{key}": value[key] if value.size > 1 else value[key].item() for key in value.dtype.names}
            return {key: runs for one in inner for key, runs in _flat(one, inner[one], depth - 1).items()}
        cells = [_flat(name, cell, depth - 1) for cell in value.ravel()]
        shared = [key for key in cells[0] if all(key in cell for cell in cells)]
        return {key: tuple(run for cell in cells for run in cell[key]) for key in shared}
    if value.dtype.kind not in "fiub" or value.ndim != 2 or max(value.shape) < 2:
        return {}
    table = np.asarray(value if value.shape[0] >= value.shape[1] else value.T, float)
    if table.shape[1] == 1:
        return {name: (table[:, 0],)}
    columns = enumerate(table.T if table.shape[1] <= MAX_MATRIX_COLUMNS else ())
    return {f"{name}:{k + 1}": (np.ascontiguousarray(column),) for k, column in columns}
