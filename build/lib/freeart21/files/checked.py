"""Reading what may come from anywhere: bounded sizes, no pickle, and one clear line for whatever is wrong."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError

MAX_JSON_BYTES = 64 << 20
MAX_ARRAY_BYTES = 1 << 30
MAX_IMAGE_BYTES = 64 << 20


def require_file(path: Path, limit: int) -> Path:
    """`path` itself when it is a file of at most `limit` bytes."""
    if not path.is_file():
        raise FreeArtError(f"{path} is missing")
    if path.stat().st_size > limit:
        raise FreeArtError(f"{path} has {path.stat().st_size} bytes, at most {limit} are read")
    return path


def inside(folder: Path, relative: str) -> Path:
    """The path of `relative` in `folder`; FreeArtError when it leads out of the folder."""
    path = (folder / relative).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise FreeArtError(f"{folder}: '{relative}' leads out of the folder")
    return path


def read_json(path: Path, schema: str | None = None) -> dict[str, Any]:
    """The JSON object in `path`, of the given schema such as 'freeart21/sequence/1'."""
    try:
        data = json.loads(require_file(path, MAX_JSON_BYTES).read_text("utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FreeArtError(f"{path} is not JSON: {error}") from error
    if not isinstance(data, dict):
        raise FreeArtError(f"{path} holds a {type(data).__name__}, expected an object")
    if schema is not None and data.get("schema") != schema:
        raise FreeArtError(f"{path} has schema '{data.get('schema')}', expected '{schema}'")
    return data


def numbers(
    data: dict[str, Any], key: str, shape: tuple[int | None, ...], path: Path, nullable: bool = False
) -> NDArray[np.float64]:
    """The array `data[key]`; None in `shape` is any length; null is NaN when `nullable`, else all must be finite."""
    if key not in data:
        raise FreeArtError(f"{path} has no '{key}'; it has {', '.join(sorted(data))}")
    try:
        array = np.array(data[key], dtype=float)
    except (TypeError, ValueError) as error:
        raise FreeArtError(f"{path}: '{key}' is not an array of numbers") from error
    expected = "(" + ", ".join("n" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"
    if array.ndim != len(shape) or any(s not in (None, a) for s, a in zip(shape, array.shape, strict=True)):
        raise FreeArtError(f"{path}: '{key}' has shape {array.shape}, expected {expected}")
    if not nullable and not np.isfinite(array).all():
        raise FreeArtError(f"{path}: '{key}' has entries that are not finite")
    return array


def text(data: dict[str, Any], key: str, path: Path) -> str:
    """The string `data[key]`."""
    value = data.get(key)
    if not isinstance(value, str):
        raise FreeArtError(f"{path}: '{key}' is {value!r}, expected text")
    return value


def read_npz(path: Path, keys: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """The named arrays of an .npz file, without pickle and of bounded size."""
    require_file(path, MAX_ARRAY_BYTES)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > MAX_ARRAY_BYTES:
                raise FreeArtError(f"{path} unpacks to {size} bytes, at most {MAX_ARRAY_BYTES} are read")
        with np.load(path, allow_pickle=False) as data:
            missing = [key for key in keys if key not in data]
            if missing:
                raise FreeArtError(f"{path} has no {', '.join(missing)}; it has {', '.join(sorted(data))}")
            return {key: data[key] for key in keys}
    except (ValueError, OSError, RuntimeError, zipfile.BadZipFile, zlib.error, EOFError, KeyError) as error:
        raise FreeArtError(f"{path} is not a readable .npz file without pickled objects: {error}") from error


def read_image(path: Path, flags: int) -> NDArray[Any]:
    """The image in `path` as OpenCV reads it."""
    data = np.fromfile(require_file(path, MAX_IMAGE_BYTES), np.uint8)
    image = cv2.imdecode(data, flags) if len(data) else None
    if image is None:
        raise FreeArtError(f"{path} is not a readable image")
    return image


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """(height, width, 3) RGB."""
    return np.ascontiguousarray(read_image(path, cv2.IMREAD_COLOR)[..., ::-1])


def read_labels(path: Path) -> NDArray[np.uint8]:
    """(height, width) uint8 labels of a single-channel image."""
    image = read_image(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise FreeArtError(f"{path} has shape {image.shape} {image.dtype}, expected one channel of uint8")
    return image


def read_uint16(path: Path) -> NDArray[np.uint16]:
    """(height, width) uint16 of a single-channel image."""
    image = read_image(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise FreeArtError(f"{path} has shape {image.shape} {image.dtype}, expected one channel of uint16")
    return image


def encode_png(image: NDArray[Any]) -> bytes:
    """PNG bytes of a (height, width) uint8 or uint16 map or a (height, width, 3) RGB image.

    OpenCV's own settings (each pixel coded by its left neighbour, run lengths, fast deflate) are the choice: naming any
    compression level makes it try all filters a row, which takes twice the time and, on pictures of objects before a
    plain background, no less room.
    """
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    ok, data = cv2.imencode(".png", image)
    if not ok:
        raise FreeArtError(f"cannot encode an image of shape {image.shape} {image.dtype} as PNG")
    return bytes(data)
