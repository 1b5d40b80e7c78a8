"""Splits a data folder into a public half for methods and a hidden half with the truth for scoring.

The public half depends only on what a video shows: pictures are decoded and re-encoded, JSON is read and rewritten,
sequences get meaningless names, and all file times are equal. Names and the salt of the truth's hash come from a secret
key, so either half can be made at any time with the same bytes.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import SCHEMA, Benchmark, read_benchmark
from freeart21.files.data_card import CARD_FILES, DataSet, card_files, describe_sequence
from freeart21.files.hashes import MAX_HASHED_BYTES, file_sha256
from freeart21.files.hidden import MARKER, hidden_digest
from freeart21.files.hidden import SCHEMA as HIDDEN_SCHEMA
from freeart21.files.places import Output
from freeart21.files.sequence import encode_depth, header_json, queries_json, read_sequence
from freeart21.files.verify import differing_files, listed_files

KEY_SCHEMA = "freeart21/pack-key/1"
EPOCH_S = 315532800
"""1980-01-01, the earliest time in a ZIP: the time of every packed file."""
PUBLIC = Output(
    "packed set",
    b'"schema": "freeart21/benchmark/1",\n "hidden": ',
    "benchmark.json",
    CARD_FILES,
)
TRUTH = Output("hidden truth", b'"schema": "freeart21/hidden-truth/', MARKER)
THREADS = 2

Progress = Callable[[int, int], None]
"""Called with the number of finished pictures (or files) and the total."""
_Files = Iterator[tuple[str, bytes]]


@dataclass(frozen=True)
class Names:
    """Names of the sequences in both halves, and the salt of the truth's hash."""

    salt: str
    packed: dict[str, str]
    """Name of a sequence in the data folder to its name in both halves."""


def default_key_path(data: Path) -> Path:
    """Default file of a data folder's key: FOLDER.key in its parent folder."""
    data = Path(data).resolve()
    return data.parent / f"{data.name}.key"


def read_or_create_key(path: Path) -> bytes:
    """The key in the file `path`; a missing file is created, readable by its owner only."""
    path = Path(path)
    if not checked.is_there(path):
        atomic.write_json(path, {"schema": KEY_SCHEMA, "key": secrets.token_hex(32)})
        path.chmod(0o600)
    text = checked.text(checked.read_json(path, KEY_SCHEMA, checked.ANYWHERE), "key", path)
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) < 16:
        raise FreeArtError(f"{path}: 'key' is not a key, expected 32 or more hexadecimal digits")
    return key


def choose_names(benchmark: Benchmark, key: bytes, keep_names: bool) -> Names:
    """The names of the sequences of `benchmark` under `key`."""

    def keyed(what: str) -> str:
        return hmac.new(key, what.encode(), "sha256").hexdigest()

    packed = {name: name if keep_names else f"seq-{keyed(f'sequence {name}')[:12]}" for name in benchmark.sequences}
    return Names(keyed("salt"), packed)


def pack_public(
    data: Path, out: Path, key: Path | None = None, keep_names: bool = False, progress: Progress = lambda done, of: None
) -> None:
    """Write the public half of the data folder `data` to the folder `out`.

    `keep_names` keeps the sequences' names, which reveal their objects. `key` is a file, created when missing; None
    means `default_key_path`. A folder that was packed before gives itself. Raises FreeArtError when `data` is broken or
    differs from its benchmark.json, or when something else exists at `out`.
    """
    benchmark = read_benchmark(data)
    _check_hashes(Path(data))
    if benchmark.hidden:
        names, hidden = {name: name for name in benchmark.sequences}, benchmark.hidden
    else:
        found = choose_names(benchmark, read_or_create_key(key or default_key_path(data)), keep_names)
        names, hidden = found.packed, hidden_digest(found.salt, _truth_hashes(benchmark, found))
    _write(Path(out), PUBLIC, _public_files(benchmark, names, hidden, progress))


def pack_truth(
    data: Path, out: Path, key: Path | None = None, keep_names: bool = False, progress: Progress = lambda done, of: None
) -> None:
    """Write the hidden half, the truth of `data`, to `out`; arguments and errors as in `pack_public`."""
    benchmark = read_benchmark(data)
    if benchmark.hidden:
        raise FreeArtError(f"{data} was packed without its truth: there is nothing to write")
    _check_hashes(Path(data))
    names = choose_names(benchmark, read_or_create_key(key or default_key_path(data)), keep_names)
    _write(Path(out), TRUTH, _truth_files(benchmark, names, progress))


def _check_hashes(data: Path) -> None:
    """Raise FreeArtError, one line, when a file is missing, unlisted, or differs from its hash in benchmark.json."""
    faults = list(differing_files(data, listed_files(data)))
    if faults:
        more = f" ({len(faults) - 1} more files differ: `freeart21 verify {data}` names them)" * (len(faults) > 1)
        raise FreeArtError(f"{faults[0]}{more}; nothing was packed")


def _public_files(benchmark: Benchmark, names: dict[str, str], hidden: str, progress: Progress) -> _Files:
    """Name and bytes of every file of the public half; benchmark.json last."""
    hashes: dict[str, str] = {}
    recordings = {names[name]: benchmark.sequence(name) for name in benchmark.sequences}
    of = sum(len(read_sequence(folder)) for folder in recordings.values())
    done = 0
    with ThreadPoolExecutor(THREADS) as pool:
        for name, folder in sorted(recordings.items()):
            for file, content in _sequence_files(folder, pool):
                hashes[f"sequences/{name}/{file}"] = hashlib.sha256(content).hexdigest()
                yield f"sequences/{name}/{file}", content
                if file.startswith("mask/"):
                    done += 1
                    progress(done, of)
    facts = {"name": benchmark.name, "version": benchmark.version, "split": benchmark.split}
    shown = [describe_sequence(name, folder, None, hashes) for name, folder in sorted(recordings.items())]
    yield from card_files(DataSet(benchmark.name, benchmark.version, benchmark.split, True, tuple(shown))).items()
    listed = {"sequences": sorted(recordings), "sha256": dict(sorted(hashes.items()))}
    yield "benchmark.json", atomic.json_text({"schema": SCHEMA, "hidden": hidden, **facts, **listed}).encode()


def _sequence_files(folder: Path, pool: ThreadPoolExecutor) -> _Files:
    """Name and bytes of every public file of one sequence, re-encoded."""
    recording = read_sequence(folder)
    scale = float(checked.read_json(folder / "sequence.json")["depth_scale"])

    def pictures(i: int) -> list[tuple[str, bytes]]:
        processes.raise_if_stopped()
        frame = recording.frame(i)
        shown = {"rgb": frame.rgb, "depth": encode_depth(frame.depth, scale), "mask": frame.mask.astype(np.uint8) * 255}
        for sub, image in shown.items():
            if image.shape[:2] != (recording.camera.height, recording.camera.width):
                raise FreeArtError(f"{folder}/{sub}/{i:05d}.png has another size than its camera")
        return [(f"{sub}/{i:05d}.png", checked.encode_png(image)) for sub, image in shown.items()]

    header = header_json(recording.camera, scale, recording.times_s, recording.licence, recording.gravity)
    yield "sequence.json", _json(header)
    yield "queries.json", _json(queries_json(recording.queries))
    for files in pool.map(pictures, range(len(recording))):
        yield from files


def _truth_files(benchmark: Benchmark, names: Names, progress: Progress) -> _Files:
    """Name and bytes of every file of the hidden half, unchanged; the marker last."""
    hashes = _truth_hashes(benchmark, names)
    paths = dict(_truth_paths(benchmark, names))
    for done, (name, path) in enumerate(sorted(paths.items())):
        yield name, checked.read_bytes(path, MAX_HASHED_BYTES)
        progress(done + 1, len(paths))
    facts = {"name": benchmark.name, "version": benchmark.version, "split": benchmark.split, "salt": names.salt}
    mapping = {packed: name for name, packed in sorted(names.packed.items(), key=lambda pair: pair[1])}
    yield MARKER, _json({"schema": HIDDEN_SCHEMA, **facts, "names": mapping, "sha256": hashes})


def _truth_paths(benchmark: Benchmark, names: Names) -> Iterator[tuple[str, Path]]:
    """Name in the hidden half and path of every file of the truth."""
    for sequence in benchmark.sequences:
        folder = benchmark.truth(sequence)
        if not (folder / "truth.json").is_file():
            raise FreeArtError(f"{folder} is not a truth: it has no truth.json")
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                yield f"truth/{names.packed[sequence]}/{path.relative_to(folder).as_posix()}", path


def _truth_hashes(benchmark: Benchmark, names: Names) -> dict[str, str]:
    return dict(sorted((name, file_sha256(path)) for name, path in _truth_paths(benchmark, names)))


def _json(data: dict[str, object]) -> bytes:
    return atomic.json_text(data).encode()


def _write(out: Path, kind: Output, files: _Files) -> None:
    """Write `files` to a folder, atomically, all with the same time."""
    with atomic.new_folder(out, kind) as staging:
        for name, content in files:
            processes.raise_if_stopped()
            path = staging / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            path.chmod(0o644)
        for path in sorted(staging.rglob("*"), reverse=True):  # contents before their folder
            if path.is_dir():
                path.chmod(0o755)
            os.utime(path, (EPOCH_S, EPOCH_S))
        os.utime(staging, (EPOCH_S, EPOCH_S))
