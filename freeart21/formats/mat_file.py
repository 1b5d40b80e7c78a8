"""Columns of numbers in a MATLAB file of version 4 to 7.

SciPy's reader crashes on some broken files, so it runs in a process of its own.
"""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.measured import MAX_BYTES
from freeart21.files.run_table import MAX_CSV_BYTES
from freeart21.se3 import Array

MAX_MATRIX_COLUMNS = 64
"""A matrix with more columns is not read."""
MAX_CELLS = 1000
"""Most cells, a run each: known recordings have at most six."""
TIME_LIMIT_S = 120.0
"""The largest file, 64 MB, takes some 2 s."""


def read_mat(path: Path) -> dict[str, tuple[Array, ...]]:
    """Column name to (n,) numbers per run, named as in `time_series`. Raises FreeArtError."""
    data = checked.read_bytes(path, MAX_CSV_BYTES, checked.ANYWHERE)
    if data[:8] == b"\x89HDF\r\n\x1a\n" or data[:10] == b"MATLAB 7.3":
        raise FreeArtError(f"{path} is a MAT file of version 7.3 (HDF5): save it by save(..., '-v7')")
    _check_unpacked(path, data)
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "columns.npz"
        try:
            done = subprocess.run(
                [*processes.command("freeart21.formats.mat_file"), str(out)],
                input=data,
                capture_output=True,
                timeout=TIME_LIMIT_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise FreeArtError(f"{path} was not read within {TIME_LIMIT_S:g} s") from error
        if done.returncode or not out.is_file():
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            reason = " ".join(lines[-1].split())[:120] if done.returncode == 1 and lines else "the reader crashed on it"
            raise FreeArtError(f"{path} is not a readable MAT file: {reason}")
        names: dict[str, int] = json.loads(done.stdout)
        runs = checked.read_npz(out, tuple(f"{k}_{i}" for k, n in enumerate(names.values()) for i in range(n)))
    return {name: tuple(runs[f"{k}_{i}"] for i in range(n)) for k, (name, n) in enumerate(names.items())}


def main() -> None:
    """Read MAT bytes on standard input; write the runs of all columns to an .npz, and their numbers to standard
    output."""
    from scipy.io import loadmat

    columns: dict[str, tuple[Array, ...]] = {}
    try:
        for name, value in loadmat(io.BytesIO(sys.stdin.buffer.read())).items():
            if not name.startswith("__"):
                columns |= _flat(name, value, 3)
    except Exception as error:
        sys.exit(str(error))
    named: dict[str, Any] = {f"{k}_{i}": run for k, runs in enumerate(columns.values()) for i, run in enumerate(runs)}
    np.savez(sys.argv[1], **named)
    print(json.dumps({name: len(runs) for name, runs in columns.items()}))


def _flat(name: str, value: Any, depth: int) -> dict[str, tuple[Array, ...]]:
    """A variable as columns; what is no series of numbers is left out."""
    value = np.asarray(value)
    if value.dtype.names and depth:  # structures
        if not 1 <= value.size <= MAX_CELLS:
            return {}
        fields = {field: value[field] if value.size > 1 else value[field].ravel()[0] for field in value.dtype.names}
        return {k: v for field, inner in fields.items() for k, v in _flat(f"{name}.{field}", inner, depth - 1).items()}
    if value.dtype == object and depth:  # cells, a run in each
        if not 1 <= value.size <= MAX_CELLS:
            return {}
        cells = [_flat(name, cell, depth - 1) for cell in value.ravel()]
        return {
            key: tuple(run for cell in cells for run in cell[key]) for key in cells[0] if all(key in c for c in cells)
        }
    if value.dtype.kind not in "fiub" or value.ndim != 2 or max(value.shape) < 2:
        return {}
    table = np.asarray(value if value.shape[0] >= value.shape[1] else value.T, float)
    if table.shape[1] == 1:
        return {name: (table[:, 0],)}
    if table.shape[1] > MAX_MATRIX_COLUMNS:
        return {}
    return {f"{name}:{k + 1}": (np.ascontiguousarray(table[:, k]),) for k in range(table.shape[1])}


def _check_unpacked(path: Path, data: bytes) -> None:
    """FreeArtError when a MAT file of version 5 unpacks to more than a measured set may hold."""
    if len(data) < 128 or data[126:128] not in (b"IM", b"MI"):
        return  # version 4 is not compressed
    order = "<" if data[126:128] == b"IM" else ">"
    place, unpacked = 128, 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        if kind == 15:
            try:
                packed = zlib.decompressobj()
                unpacked += len(packed.decompress(data[place + 8 : place + 8 + size], MAX_BYTES + 1 - unpacked))
            except zlib.error as error:
                raise FreeArtError(f"{path} is not a readable MAT file: {error}") from error
        if unpacked > MAX_BYTES:
            raise FreeArtError(f"{path} unpacks to more than {MAX_BYTES} bytes, the most that are read")
        place += 8 + size
