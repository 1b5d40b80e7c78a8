"""Data folders without their truth: how to recognise the truth, and how to check that no trace of it is left.

Their benchmark.json has `hidden`, a salted hash of all truth files. Without the salt, which is stored with the truth,
anybody could confirm a guess of the truth, such as a recording of the same object with a known seed.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.hashes import file_sha256
from freeart21.files.sequence import header_json, queries_json, read_sequence

SCHEMA = "freeart21/hidden-truth/1"
MARKER = "hidden.json"
PICTURES = ("rgb", "depth", "mask")
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FORMS = {"rgb": (8, 2, 3), "depth": (16, 0, 2), "mask": (8, 0, 1)}
"""Subfolder to bit depth, colour type (PNG specification, 11.2.2) and bytes per pixel of its pictures."""


@dataclass(frozen=True)
class Hidden:
    """The truth that was left out of a packed data folder."""

    folder: Path
    salt: str
    names: dict[str, str]
    """Name of a sequence in the data folder to its name where it was recorded."""
    sha256: dict[str, str]
    """File of the truth, relative to this folder, to its hash."""

    @property
    def digest(self) -> str:
        """`hidden` in benchmark.json of the data folder."""
        return hidden_digest(self.salt, self.sha256)


def hidden_digest(salt: str, sha256: Mapping[str, str]) -> str:
    """Salted SHA-256, hexadecimal, of file names and their hashes."""
    return hashlib.sha256(json.dumps([salt, sorted(sha256.items())]).encode()).hexdigest()


def read_hidden(folder: Path) -> Hidden:
    """The hidden truth in `folder`; every file is checked against its hash. Raises FreeArtError."""
    folder = Path(folder)
    path = folder / MARKER
    if not checked.is_there(path):
        raise FreeArtError(f"{folder} is no truth of a packed set: it has no {MARKER}")
    data = checked.read_json(path, SCHEMA)
    tables: dict[str, dict[str, str]] = {}
    for key in ("names", "sha256"):
        table = data.get(key)
        if not isinstance(table, dict) or not all(isinstance(value, str) for value in table.values()):
            raise FreeArtError(f"{path}: '{key}' is no object of texts")
        tables[key] = table
    for name, expected in tables["sha256"].items():
        file = checked.inside(folder, name)
        if not file.is_file() or file_sha256(file) != expected:
            raise FreeArtError(f"{folder}/{name} is missing, or is not the file that was packed")
    return Hidden(folder, checked.text(data, "salt", path), tables["names"], tables["sha256"])


def find_traces(sequence: Path) -> Iterator[str]:
    """A line for everything in a sequence folder that could leak the truth to a method.

    Pictures hold pixels only (no other chunks, no bytes behind their end or their pixels; masks are black and white),
    JSON is byte for byte what our writer writes, and there is no other file.
    """
    recording = read_sequence(sequence)
    n = len(recording)
    allowed = {"sequence.json", "queries.json"} | {f"{sub}/{i:05d}.png" for sub in PICTURES for i in range(n)}
    for path in sorted(sequence.rglob("*")):
        name = path.relative_to(sequence).as_posix()
        if path.is_symlink() or not (name in allowed or (path.is_dir() and name in PICTURES)):
            yield f"{path} does not belong to what a method sees"
    scale = checked.read_json(sequence / "sequence.json").get("depth_scale")
    written: dict[str, Any] = {
        "sequence.json": header_json(
            recording.camera,
            scale,  # type: ignore[arg-type]
            recording.times_s,
            recording.licence,
            recording.gravity,
        ),
        "queries.json": queries_json(recording.queries),
    }
    for name, data in written.items():
        path = sequence / name
        if path.is_file() and checked.read_bytes(path, checked.MAX_JSON_BYTES) != atomic.json_text(data).encode():
            yield f"{path} is not as our writer writes it: it could hold more than its values"
    size = recording.camera.width, recording.camera.height
    for sub in PICTURES:
        for i in range(n):
            try:
                wrong = _beyond_pixels(sequence / sub / f"{i:05d}.png", sub, size)
            except FreeArtError as error:
                yield str(error)
                continue
            if wrong:
                yield f"{sequence}/{sub}/{i:05d}.png {wrong}"


def _beyond_pixels(path: Path, sub: str, size: tuple[int, int]) -> str:
    """What a picture holds besides its pixels; '' when nothing."""
    data = checked.read_bytes(path, checked.MAX_IMAGE_BYTES, path.parent.parent)
    if not data.startswith(_SIGNATURE):
        return "is no PNG"
    at, packed, kinds = len(_SIGNATURE), [], []
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if len(body) < length:
            return "is cut off"
        kinds.append(kind)
        if kind == b"IHDR" and struct.unpack(">IIBBBBB", body) != (*size, *_FORMS[sub][:2], 0, 0, 0):
            return "has another size, bit depth or colour type than our pictures"
        packed += [body] if kind == b"IDAT" else []
        at += 12 + length
        if kind == b"IEND":
            break
    odd = [kind for kind in kinds if kind not in (b"IHDR", b"IDAT", b"IEND")]
    if odd:
        return f"has a chunk {odd[0]!r}, which is no pixels"
    if at != len(data) or kinds[:1] != [b"IHDR"] or kinds[-1] != b"IEND" or kinds.count(b"IEND") != 1:
        return "has bytes behind its end"
    row = 1 + size[0] * _FORMS[sub][2]
    stream = zlib.decompressobj()
    try:
        pixels = stream.decompress(b"".join(packed), size[1] * row + 1)
    except zlib.error:
        return "is no PNG"
    if len(pixels) != size[1] * row or not stream.eof or stream.unused_data:
        return "has bytes behind its pixels"
    if sub == "mask" and not set(checked.read_labels(path).ravel().tolist()) <= {0, 255}:
        return "has other values than 0 and 255"
    return ""
