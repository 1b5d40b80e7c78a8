"""The card of a data folder: README.md as the Hugging Face hub shows it, croissant.json, and a line for every sequence.

All are made from the folder's own files, so that equal data have equal cards. A card of a folder without its truth has
nothing of the truth. Croissant 1.0: http://mlcommons.org/croissant/1.0.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import freeart21
from freeart21.files import atomic, checked
from freeart21.files.benchmark import read_benchmark
from freeart21.statistics import FEW, HARD_FRAMES

README, CROISSANT, TABLE = "README.md", "croissant.json", "sequences.jsonl"
CARD_FILES = (README, CROISSANT, TABLE)
"""No data: they are in no list of hashes."""
MARK = "<!-- freeart21 data card -->"
"""In a README.md that we may replace."""
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
"""Below that number of rows: the hub's name of the size."""
_CROISSANT_TYPES = {str: "sc:Text", int: "sc:Integer", float: "sc:Float", bool: "sc:Boolean"}
_LICENCES = {"CC0-1.0": "cc0-1.0", "CC-BY-4.0": "cc-by-4.0", "Apache-2.0": "apache-2.0", "MIT": "mit"}
"""SPDX to the hub's names; others are 'other'."""


@dataclass(frozen=True)
class SequenceFacts:
    """What the card says of one sequence. Facts of the truth are None where that is hidden."""

    sequence: str
    frames: int
    seconds: float
    width: int
    height: int
    queries: int
    licence: str
    sha256: str
    """Of the names and hashes of its video's files."""
    joint_type: str | None = None
    object: str | None = None
    category: str | None = None
    motion: str | None = None
    sensor: str | None = None
    seed: int | None = None
    few_pixels_share: float | None = None
    """Share of frames in which the moving part has less than FEW of the object's pixels."""
    hard: bool | None = None


@dataclass(frozen=True)
class DataSet:
    """What the card says of the whole."""

    name: str
    version: str
    split: str
    hidden: bool
    sequences: tuple[SequenceFacts, ...]
    doi: str = ""
    """Such as 10.5281/zenodo.123; empty until one is given."""


def describe_sequence(name: str, sequence: Path, truth: Path | None, hashes: Mapping[str, str]) -> SequenceFacts:
    """The facts of a sequence folder, and of its truth folder where that is public.

    `hashes` has the SHA-256 of every file of the data folder's half, by name from its root.
    """
    header, queries = sequence / "sequence.json", sequence / "queries.json"
    data = checked.read_json(header)
    camera, times = checked.json_object(data, "camera", header), checked.numbers(data, "times_s", (None,), header)
    views = checked.read_json(queries).get("queries") if checked.is_there(queries) else []
    own = sorted((key, value) for key, value in hashes.items() if key.startswith(f"sequences/{name}/"))
    facts = SequenceFacts(
        name,
        len(times),
        round(float(times[-1] - times[0]), 3) if len(times) else 0.0,
        int(checked.number(camera, "width", header)),
        int(checked.number(camera, "height", header)),
        len(views) if isinstance(views, list) else 0,
        str(data.get("licence") or "unknown"),
        hashlib.sha256(json.dumps(own).encode()).hexdigest(),
    )
    if truth is None:
        return facts
    known = checked.read_json(truth / "truth.json")
    source, joint = known.get("source"), checked.json_object(known, "joint", truth)
    words = source if isinstance(source, dict) else {}
    seen = checked.read_npz(truth / "seen.npz", ("seen",), truth)["seen"]
    share = float(np.mean(seen[:, 1] < FEW * np.maximum(seen.sum(1), 1)))
    texts = {key: str(words[key]) for key in ("object", "category", "motion", "sensor") if words.get(key) is not None}
    seed = words.get("seed")
    more = {"joint_type": str(joint.get("type")), "seed": seed if isinstance(seed, int) else None, **texts}
    return SequenceFacts(**{**asdict(facts), **more, "few_pixels_share": round(share, 4), "hard": share >= HARD_FRAMES})


def card_files(
    data: DataSet, table: str = TABLE, shards: Mapping[str, tuple[int, str]] | None = None
) -> dict[str, bytes]:
    """Name to content of the card's files.

    `table` is the file that the hub shows, when it is another one; `shards` are the tar files of a release with their
    bytes and SHA-256.
    """
    lines = "".join(json.dumps(asdict(one)) + "\n" for one in data.sequences).encode()
    text = readme(data, table, bool(shards))
    return {README: text.encode(), CROISSANT: croissant(data, lines, shards or {}).encode(), TABLE: lines}


def write_card_of(folder: Path) -> None:
    """Write the card of a finished data folder, from its benchmark.json and its sequences; a README.md without our
    mark stays. Raises FreeArtError."""
    for name, content in card_files(describe(folder)).items():
        path = folder / name
        if name == README and checked.is_there(path) and MARK.encode() not in checked.read_head(path, 1 << 16):
            continue
        atomic.write_bytes(path, content)


def describe(folder: Path, doi: str = "") -> DataSet:
    """The facts of a data folder."""
    benchmark, path = read_benchmark(folder), Path(folder) / "benchmark.json"
    hashes = checked.json_object(checked.read_json(path), "sha256", path)
    facts = []
    for name in benchmark.sequences:
        truth = None if benchmark.hidden else benchmark.truth(name)
        facts.append(describe_sequence(name, benchmark.sequence(name), truth, hashes))
    words = benchmark.name, benchmark.version, benchmark.split
    return DataSet(*words, bool(benchmark.hidden), tuple(facts), doi)


def readme(data: DataSet, table: str = TABLE, sharded: bool = False) -> str:
    """README.md: the hub's YAML header, then text."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    licences = Counter(one.licence for one in data.sequences)
    known = {_LICENCES.get(licence, "other") for licence in licences}
    pages = Environment(
        loader=PackageLoader("freeart21.files"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    pages.filters |= {"yaml": json.dumps, "cell": _cell}  # JSON's strings are YAML's
    return pages.get_template("data_card.md.j2").render(
        data=data,
        table=table,
        sharded=sharded,
        mark=MARK,
        hub_licence=known.pop() if len(known) == 1 else "other",
        size=next((name for limit, name in _SIZES if len(data.sequences) < limit), "n>1M"),
        split=re.sub("[^A-Za-z0-9_]+", "_", data.split) or "all",
        summary=_summary(data),
        statistics=_statistics(data, licences),
    )


def _summary(data: DataSet) -> str:
    return (
        "RGB-D videos of articulated objects with one joint that move freely in front of the camera, for methods that "
        "reconstruct two rigid parts, their joint, its state in every frame, and an asset for simulators. "
        f"Made by [FreeArt-21](https://arxiv.org/abs/2603.22102)'s toolchain, freeart21 {freeart21.__version__}."
    )


def _statistics(data: DataSet, licences: Mapping[str, int]) -> list[tuple[str, str]]:
    ones, frames = data.sequences, sum(one.frames for one in data.sequences)
    rows = [
        ("sequences", str(len(ones))),
        ("frames", str(frames)),
        ("pictures, pixels", _counted(Counter(f"{one.width} x {one.height}" for one in ones))),
        ("held-out views", str(sum(one.queries for one in ones))),
        ("licence", _counted(licences)),
        ("split", data.split),
    ]
    for what in ("joint_type", "category", "motion", "sensor"):
        values = Counter(str(value) for one in ones if (value := getattr(one, what)) is not None)
        rows += [(what.replace("_", " "), _counted(values))] if values else []
    hard = [one.hard for one in ones if one.hard is not None]
    text = f"{sum(hard)} of {len(hard)}: less than {FEW:.0%} of the pixels in {HARD_FRAMES:.0%} of the frames"
    rows += [("hard (moving part hardly seen)", text)] if hard else []
    return [*rows, ("DOI", data.doi or "none yet")]


def croissant(data: DataSet, table: bytes, shards: Mapping[str, tuple[int, str]]) -> str:
    """croissant.json of the table of sequences, a record for each, and of the shards."""
    files = {TABLE: ("application/jsonlines", len(table), hashlib.sha256(table).hexdigest())}
    files |= {name: ("application/x-tar", *facts) for name, facts in shards.items()}
    fields = []
    for name, kind in SequenceFacts.__annotations__.items():
        plain = {"str": str, "int": int, "float": float, "bool": bool}[kind.partition(" ")[0]]
        source = {"fileObject": {"@id": TABLE}, "extract": {"column": name}}
        named = {"@type": "cr:Field", "@id": f"sequences/{name}", "name": name}
        fields.append({**named, "dataType": _CROISSANT_TYPES[plain], "source": source})
    licences = sorted({one.licence for one in data.sequences})
    body: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": data.name,
        "description": _summary(data),
        "version": data.version if re.fullmatch(r"\d+(\.\d+){0,2}", data.version) else "1",
        "license": licences,
        "url": f"https://doi.org/{data.doi}" if data.doi else "https://arxiv.org/abs/2603.22102",
        **({"citeAs": f"https://doi.org/{data.doi}"} if data.doi else {}),
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": name,
                "name": name,
                "contentUrl": name,
                "contentSize": f"{size} B",
                "encodingFormat": kind,
                "sha256": digest,
            }
            for name, (kind, size, digest) in files.items()
        ],
        "recordSet": [{"@type": "cr:RecordSet", "@id": "sequences", "name": "sequences", "field": fields}],
    }
    return json.dumps(body, indent=1) + "\n"


_OWN = (
    "citeAs column extract field fileObject fileProperty fileSet format includes isLiveDataset jsonPath key md5 "
    "parentField path recordSet references regex repeated replace separator source subField transform"
)
"""Croissant's own words, which mean the same in its name space."""
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{word: f"cr:{word}" for word in _OWN.split()},
}


def _counted(values: Mapping[str, int]) -> str:
    return ", ".join(f"{value} ({count})" if len(values) > 1 else value for value, count in sorted(values.items()))


def _cell(text: str) -> str:
    """A text in a cell of a Markdown table."""
    return re.sub(r"([\\`*_\[\]|~#<>])", r"\\\1", " ".join(text.split()))
