"""Data folders as tar files of a bounded number of sequences, and a Parquet manifest of all sequences.

Each shard holds a whole data folder, with a benchmark.json of its own sequences: it can be verified and scored alone,
and no reader needs the millions of files of the others. The manifest is what the Hugging Face hub shows.
"""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_type_hints

import cv2

from freeart21 import processes
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import SCHEMA, Benchmark, read_benchmark
from freeart21.files.data_card import SequenceFacts, card_files, describe
from freeart21.files.hashes import MAX_HASHED_BYTES, file_sha256
from freeart21.files.sequence import read_sequence

MANIFEST = "manifest.parquet"
EPOCH_S = 315532800
"""1980-01-01: the time of every file in a shard, so that equal data give equal bytes."""
PREVIEW_WIDTH, PREVIEW_QUALITY = 160, 80
_HUB_TYPES = {str: "string", int: "int64", float: "float64", bool: "bool"}
Progress = Callable[[str, int, int], None]


def write_shards(
    data: Sequence[Path], out: Path, per_shard: int = 64, doi: str = "", progress: Progress = lambda *_: None
) -> int:
    """Write shards/NAME-00000.tar, ..., manifest.parquet and the card to the new folder `out`; gives their number.

    `data` are data folders of one name, version and split, with or without their truth; each gives shards of its own,
    of at most `per_shard` sequences. Raises FreeArtError for other folders, a sequence that occurs twice, a file that
    differs from its hash, and without pyarrow.
    """
    if per_shard < 1:
        raise FreeArtError(f"release: --per-shard is {per_shard}, expected 1 or more")
    _pyarrow()
    benchmarks = [read_benchmark(folder) for folder in data]
    sets = [describe(folder, doi) for folder in data]
    labels = [f"{one.name} {one.version}, {one.split}{', hidden' * one.hidden}" for one in sets]
    for folder, label in zip(data, labels, strict=True):
        if label != labels[0]:
            raise FreeArtError(f"{folder} is {label}; expected {labels[0]}, as {data[0]}")
    whole = replace(sets[0], sequences=tuple(fact for one in sets for fact in one.sequences))
    names = [fact.sequence for fact in whole.sequences]
    twice = next((name for name in names if names.count(name) > 1), None) if len(data) > 1 else None
    if twice:
        raise FreeArtError(f"{twice} is in two of the folders, expected every sequence once")
    chunks = [
        (benchmark, one.sequences[k : k + per_shard])
        for benchmark, one in zip(benchmarks, sets, strict=True)
        for k in range(0, len(one.sequences), per_shard)
    ]
    done = 0
    with atomic.new_folder(Path(out)) as new:
        (new / "shards").mkdir()
        shards: dict[str, tuple[int, str]] = {}
        rows: list[dict[str, Any]] = []
        for k, (benchmark, facts) in enumerate(chunks):
            name = f"shards/{_plain(whole.name)}-{k:05d}.tar"
            for fact in _write_shard(new / name, benchmark, facts):
                done += 1
                progress(f"Packed {fact.sequence}", done, len(names))
            shards[name] = (new / name).stat().st_size, file_digest(new / name)
            for fact in facts:
                preview = {"bytes": _preview(benchmark.sequence(fact.sequence)), "path": f"{fact.sequence}.jpg"}
                place = {"shard": name, "shard_sha256": shards[name][1]}
                rows.append({**asdict(fact), **place, "preview": preview})
        _write_manifest(new / MANIFEST, rows)
        for name, content in card_files(whole, MANIFEST, shards).items():
            atomic.write_bytes(new / name, content)
    return len(chunks)


def file_digest(path: Path) -> str:
    """SHA-256 (hexadecimal) of a file of any size."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()


def _write_shard(path: Path, benchmark: Benchmark, facts: Sequence[SequenceFacts]) -> Iterator[SequenceFacts]:
    """Write a shard; yields each sequence that is in it."""
    listed = checked.json_object(checked.read_json(benchmark.folder / "benchmark.json"), "sha256", benchmark.folder)
    chosen = {fact.sequence for fact in facts}
    own = {name: digest for name, digest in sorted(listed.items()) if name.split("/")[1] in chosen}
    head = {"name": benchmark.name, "version": benchmark.version, "split": benchmark.split}
    hidden = {"hidden": benchmark.hidden} if benchmark.hidden else {}
    body = {"schema": SCHEMA, **hidden, **head, "sequences": sorted(chosen), "sha256": own}
    whole = set(benchmark.sequences) == chosen
    folder = path.stem
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as archive:
        text = atomic.json_text(body).encode()
        if whole:  # the very bytes, by which score tables know a benchmark
            text = checked.read_bytes(benchmark.folder / "benchmark.json", checked.MAX_JSON_BYTES)
        _add(archive, f"{folder}/benchmark.json", text)
        for fact in facts:
            for name, digest in own.items():
                if name.split("/")[1] != fact.sequence:
                    continue
                processes.raise_if_stopped()
                place = checked.inside(benchmark.folder, name)
                if file_sha256(place, benchmark.folder) != digest:
                    raise FreeArtError(f"{benchmark.folder / name} differs from its hash in benchmark.json")
                _add(archive, f"{folder}/{name}", checked.read_bytes(place, MAX_HASHED_BYTES, benchmark.folder))
            yield fact


def _add(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size, entry.mtime, entry.mode = len(content), EPOCH_S, 0o644
    archive.addfile(entry, io.BytesIO(content))


def _write_manifest(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write the rows as Parquet, with the types that the Hugging Face hub reads."""
    arrow = _pyarrow()
    from pyarrow import parquet

    hints = {name: _plain_type(hint) for name, hint in get_type_hints(SequenceFacts).items()}
    hints |= {"shard": str, "shard_sha256": str}
    kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_()}
    image = arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())])
    features = {name: {"_type": "Value", "dtype": _HUB_TYPES[kind]} for name, kind in hints.items()}
    hub = json.dumps({"info": {"features": {**features, "preview": {"_type": "Image"}}}})
    columns = [*((name, kinds[kind]) for name, kind in hints.items()), ("preview", image)]
    schema = arrow.schema(columns, metadata={"huggingface": hub})
    parquet.write_table(arrow.Table.from_pylist(rows, schema=schema), path)


def _preview(sequence: Path) -> bytes:
    """JPEG of the first frame."""
    rgb = read_sequence(sequence).frame(0).rgb
    height = max(1, round(PREVIEW_WIDTH * rgb.shape[0] / rgb.shape[1]))
    small = cv2.resize(rgb, (PREVIEW_WIDTH, height), interpolation=cv2.INTER_AREA)
    ok, jpeg = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, PREVIEW_QUALITY])
    assert ok
    return jpeg.tobytes()


def _plain_type(hint: Any) -> type:
    """The type of a field without its None."""
    return next(kind for kind in _HUB_TYPES if hint is kind or kind in getattr(hint, "__args__", ()))


def _plain(name: str) -> str:
    from leaderboard.site.names import file_names

    return file_names([name])[0]


def _pyarrow() -> Any:
    try:
        import pyarrow
    except ImportError as error:
        raise FreeArtError("release: the manifest needs pyarrow: pip install 'freeart21[release]'") from error
    return pyarrow
