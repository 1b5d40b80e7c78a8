"""Reading untrusted files: the only module that opens files of users.

A file is opened only when it is a regular file (no pipe, device or socket) of bounded size, and no link leads out of
its folder. Nothing in it is executed. What it claims to hold (depth of JSON, shapes of arrays, sizes of pictures) is
checked against limits and against its bytes before memory is allocated. Every error is one clear line.

`root` is the folder that the user named: a file that resolves to a place outside of it is refused. The default is the
file's own folder. ANYWHERE is the root of a file that the user named directly, which can be a link.
"""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, TypeGuard, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError

MAX_JSON_BYTES = 64 << 20
MAX_JSON_DEPTH = 64
"""Nested lists and objects; the deepest file of ours, comparison.json, has 7."""
MAX_DIGITS = 300
"""Digits of a whole number in JSON: any shorter one is a finite float. A longer one is read as infinite, as 1e999."""
MAX_ARRAY_BYTES = 1 << 30
MAX_DIRECTORY_BYTES = 1 << 20
"""Size of an .npz file's list of arrays, some 60 bytes each."""
MAX_IMAGE_BYTES = 64 << 20
MAX_PIXELS = 1 << 26
"""8192 x 8192: the largest textures of renderers. Video frames have at most a quarter of it."""
_MAX_SEGMENTS = 1 << 16
"""JPEG segments before the picture, and fill bytes: cameras write tens."""
ANYWHERE = Path(os.sep)
"""The root of a file that the user named directly."""
ABOVE_ZERO = math.ulp(0.0)
"""The smallest number above zero."""
_NO_LIMIT = 1 << 62
_SPECIAL = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
_ABSENT = (errno.ENOENT, errno.ENOTDIR)


# --- opening ----------------------------------------------------------------------------------------------------------


def open_file(path: Path, limit: int, root: Path | None = None) -> BufferedReader:
    """`path`, opened for reading in binary; the caller closes it.

    Raises FreeArtError when it is missing, no regular file, larger than `limit` bytes or unreadable, or when a link
    leads out of `root` (see the module).
    """
    path = Path(path)
    try:
        if _leads_out(path, root):
            folder = path.parent if root is None else root
            raise FreeArtError(f"{path} leads out of {folder} by a link, expected the file itself: copy it there")
        _require_plain(path, path.stat(), limit)  # before opening it, on which a device can act
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            _require_plain(path, os.fstat(handle), limit)
            return os.fdopen(handle, "rb")
        except BaseException:
            os.close(handle)
            raise
    except OSError as error:
        raise _unreadable(path, error) from error
    except (ValueError, RuntimeError) as error:  # a name with a NUL, a circle of links
        raise FreeArtError(f"{str(path)!r} cannot be looked up: {error}") from error


def read_bytes(path: Path, limit: int, root: Path | None = None) -> bytes:
    """All bytes of the file `path`. Raises FreeArtError as `open_file`."""
    with open_file(path, limit, root) as file:
        try:
            return file.read(os.fstat(file.fileno()).st_size)
        except OSError as error:
            raise _unreadable(path, error) from error


def read_head(path: Path, count: int, root: Path | None = None) -> bytes:
    """The first `count` bytes of a file of any size, or all that it has. Raises FreeArtError as `open_file`."""
    with open_file(path, _NO_LIMIT, root) as file:
        try:
            return file.read(count)
        except OSError as error:
            raise _unreadable(path, error) from error


def read_text(path: Path, limit: int, root: Path | None = None, encoding: str = "utf-8", errors: str = "strict") -> str:
    """The text in `path`, lines ended by line feeds. Raises FreeArtError as `open_file`, and when it is not text."""
    try:
        text = read_bytes(path, limit, root).decode(encoding, errors)
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{path} is not text: {error}") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def is_there(path: Path) -> bool:
    """Whether anything has this name, also a broken link: readers then refuse it instead of skipping it as absent."""
    return path.exists() or path.is_symlink()


def require_file(path: Path, limit: int, root: Path | None = None) -> Path:
    """`path` itself, checked as by `open_file`, for a library that opens it by name."""
    open_file(path, limit, root).close()
    return path


def copy_folder(source: Path, target: Path) -> None:
    """Copy all files below `source` to the folder `target`. Raises FreeArtError as `open_file` with root `source`."""
    target.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.rglob("*")):
        place = target / path.relative_to(source)
        if path.is_dir() and not path.is_symlink():
            place.mkdir(parents=True, exist_ok=True)
        else:
            require_file(path, MAX_ARRAY_BYTES, source)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, place)


def require_inside(folder: Path, path: Path) -> Path:
    """`path` itself, which is in `folder`; FreeArtError when a link on the way leads out of the folder."""
    inside(folder, str(path.relative_to(folder)))
    return path


def inside(folder: Path, relative: str) -> Path:
    """The path of `relative` in `folder`, links followed; FreeArtError when it leads out of the folder."""
    try:
        path = (folder / relative).resolve()
        within = path.is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # a circle of links, a name too long or with a NUL
        raise FreeArtError(f"{folder}: '{relative[:80]}' cannot be looked up: {error}") from error
    if not within:
        raise FreeArtError(f"{folder}: '{relative}' leads out of the folder")
    return path


def _leads_out(path: Path, root: Path | None) -> bool:
    """Whether `path` resolves to a place outside of `root` (None: its folder). Costs one lstat for each folder below
    it."""
    if root == ANYWHERE:
        return False
    place = path.parent if root is None else Path(root)
    try:
        below = path.relative_to(place).parts
    except ValueError:
        below = ("..",)
    at = place
    for part in below:
        at = at / part
        if part == ".." or at.is_symlink():
            return not path.resolve().is_relative_to(place.resolve())
    return False


def _require_plain(path: Path, facts: os.stat_result, limit: int) -> None:
    if not stat.S_ISREG(facts.st_mode):
        raise FreeArtError(f"{path} is {_SPECIAL.get(stat.S_IFMT(facts.st_mode), 'no file')}, expected a file")
    if facts.st_size > limit:
        raise FreeArtError(f"{path} has {facts.st_size} bytes, at most {limit} are read")


def _unreadable(path: Path, error: OSError) -> FreeArtError:
    if error.errno in _ABSENT:
        return FreeArtError(f"{path} is missing")
    return FreeArtError(f"{path} cannot be read: {error.strerror or error}")


# --- JSON -------------------------------------------------------------------------------------------------------------


def parse_json(text: str, where: Path | str) -> Any:
    """The JSON value of `text`, of at most MAX_JSON_DEPTH levels; FreeArtError, which begins with `where`,
    otherwise."""
    try:
        data = json.loads(text, parse_int=_whole_number)
    except RecursionError:
        raise _too_deep(where) from None
    except ValueError as error:
        raise FreeArtError(f"{where} is not JSON: {error}") from error
    if not _fits(data, MAX_JSON_DEPTH - 1):
        raise _too_deep(where)
    return data


def _fits(value: Any, levels: int) -> bool:
    """Whether a JSON value has at most so many levels of lists and objects."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels >= 0 and all(_fits(one, levels - 1) for one in inner if isinstance(one, dict | list))


def read_any_json(path: Path, root: Path | None = None, limit: int = MAX_JSON_BYTES) -> Any:
    """The JSON value in `path`."""
    data = read_bytes(path, limit, root)
    try:
        return parse_json(data.decode("utf-8"), path)
    except UnicodeDecodeError as error:
        raise FreeArtError(f"{path} is not JSON: {error}") from error


def read_json(
    path: Path, schema: str | None = None, root: Path | None = None, limit: int = MAX_JSON_BYTES
) -> dict[str, Any]:
    """The JSON object in `path`, of the given schema such as 'freeart21/sequence/1'."""
    data = read_any_json(path, root, limit)
    if not isinstance(data, dict):
        raise FreeArtError(f"{path} holds a {type(data).__name__}, expected an object")
    if schema is not None and data.get("schema") != schema:
        raise FreeArtError(f"{path} has schema '{str(data.get('schema'))[:60]}', expected '{schema}'")
    return data


def numbers(
    data: dict[str, Any], key: str, shape: tuple[int | None, ...], path: Path, nullable: bool = False
) -> NDArray[np.float64]:
    """The array `data[key]` of `shape`, where None is any length. Entries are finite, or null (NaN) when `nullable`."""
    if key not in data:
        raise FreeArtError(f"{path} has no '{key}'; it has {', '.join(sorted(data))[:300]}")
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
        raise FreeArtError(f"{path}: '{key}' is {str(value)[:60]}, expected text")
    return value


@contextmanager
def naming(where: Path | str) -> Iterator[None]:
    """A FreeArtError of the block begins with `where`, unless it names it."""
    try:
        yield
    except FreeArtError as error:
        raise error if str(where) in str(error) else FreeArtError(f"{where}: {error}") from error


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a JSON value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def number(
    data: dict[str, Any],
    key: str,
    where: Path | str,
    low: float = -math.inf,
    high: float = math.inf,
    expected: str = "a finite number",
) -> float:
    """The finite number `data[key]`, from `low` to `high`; `expected` says so in the error."""
    value = data.get(key)
    if not is_number(value) or not low <= value <= high:
        raise FreeArtError(f"{where}: '{key}' is {shorten(value)}, expected {expected}")
    return float(value)


def one_of(data: dict[str, Any], key: str, choices: Sequence[str], where: Path | str) -> str:
    """The text `data[key]`, one of `choices`."""
    value = data.get(key)
    if value not in choices:
        raise FreeArtError(f"{where}: '{key}' is {shorten(value)}, expected {' or '.join(choices)}")
    return str(value)


def json_object(data: dict[str, Any], key: str, where: Path | str) -> dict[str, Any]:
    """The JSON object `data[key]`."""
    value = data.get(key)
    if not isinstance(value, dict):
        raise FreeArtError(f"{where}: '{key}' is {shorten(value)}, expected an object")
    return value


def shorten(value: Any) -> str:
    """At most sixty characters of the repr of an untrusted value."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _whole_number(digits: str) -> int | float:
    return int(digits) if len(digits) <= MAX_DIGITS else float(digits)


def _too_deep(where: Path | str) -> FreeArtError:
    return FreeArtError(f"{where} is not JSON of at most {MAX_JSON_DEPTH} levels: it is nested too deeply")


# --- arrays -----------------------------------------------------------------------------------------------------------


def read_npz(
    path: Path,
    keys: tuple[str, ...] | None = None,
    root: Path | None = None,
    optional: tuple[str, ...] = (),
    limit: int | None = None,
) -> dict[str, NDArray[Any]]:
    """The named arrays (all when None) of an .npz file, and those of `optional` that it has, without pickle.

    The file has at most `limit` bytes (default MAX_ARRAY_BYTES), packed and unpacked. Raises FreeArtError when an array
    is missing, or its header claims more data than there is.
    """
    limit = MAX_ARRAY_BYTES if limit is None else limit
    try:
        with open_file(path, limit, root) as file, open_zip(file, path, MAX_DIRECTORY_BYTES) as archive:
            entries = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            size = sum(info.file_size for info in entries.values())
            if size > limit:
                raise FreeArtError(f"{path} unpacks to {size} bytes, at most {limit} are read")
            missing = [key for key in keys or () if key not in entries]
            if missing:
                raise FreeArtError(f"{path} has no {', '.join(missing)}; it has {', '.join(sorted(entries))[:300]}")
            found = {}
            for key in entries if keys is None else (*keys, *(key for key in optional if key in entries)):
                with archive.open(entries[key]) as member:
                    found[key] = _read_array(member, entries[key].file_size, f"its array '{key}'")
            return found
    except _NO_ARRAY as error:
        raise FreeArtError(f"{path} is not a readable .npz file without pickled objects: {error}") from error


def read_npy(path: Path, root: Path | None = None, limit: int = MAX_ARRAY_BYTES) -> NDArray[Any]:
    """The array of an .npy file, as `read_npz`."""
    try:
        with open_file(path, limit, root) as file:
            return _read_array(file, os.fstat(file.fileno()).st_size, "its array")
    except _NO_ARRAY as error:
        raise FreeArtError(f"{path} is not a readable array without pickled objects: {error}") from error


def open_zip(file: IO[bytes], path: Path, limit: int) -> zipfile.ZipFile:
    """The zip archive in `file`, named `path`. FreeArtError when its directory has over `limit` bytes.

    ZipFile reads the whole directory at once, before it can be checked. Raises also what ZipFile raises.
    """
    bounded = _BoundedReads(file, path, limit)
    archive = zipfile.ZipFile(cast(IO[bytes], bounded))
    bounded.limit = _NO_LIMIT
    return archive


class _BoundedReads:
    """A file that refuses reads of more than `limit` bytes."""

    def __init__(self, file: IO[bytes], path: Path, limit: int):
        self.limit, self._file, self._path = limit, file, path

    def read(self, size: int = -1) -> bytes:
        """Read as the file does."""
        if size > self.limit:
            raise FreeArtError(f"{self._path} has a directory of {size} bytes, at most {self.limit} are read")
        return self._file.read(size)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _read_array(file: IO[bytes], size: int, what: str) -> NDArray[Any]:
    """The array in an .npy stream of `size` bytes. The header is checked first: NumPy allocates what it claims."""
    version = np.lib.format.read_magic(file)
    if version not in _NPY_HEADERS:
        raise ValueError(f"{what} has version {version}, expected 1.0 or 2.0")
    shape, _, dtype = _NPY_HEADERS[version](file)
    if dtype.hasobject:
        raise ValueError(f"{what} holds objects")
    claimed = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or dtype.itemsize < 1 or claimed > size - file.tell():
        raise ValueError(
            f"{what} claims shape {str(shape)[:60]} of {str(dtype)[:60]}, {claimed} bytes; it has {size - file.tell()}"
        )
    file.seek(0)
    return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


_NPY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_NO_ARRAY = (
    *(ValueError, OSError, RuntimeError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile, zlib.error),
    *(TypeError, struct.error, OverflowError, MemoryError),  # of malformed headers
)


# --- pictures ---------------------------------------------------------------------------------------------------------


def read_image(path: Path, flags: int, root: Path | None = None) -> NDArray[Any]:
    """The image in `path` as OpenCV reads it: PNG, JPEG or BMP of at most MAX_PIXELS.

    Raises FreeArtError on anything else, before it is unpacked.
    """
    return decode_image(read_bytes(path, MAX_IMAGE_BYTES, root), path, flags)


def decode_image(data: bytes, path: Path, flags: int) -> NDArray[Any]:
    """As `read_image`, from the bytes of the file `path`."""
    try:
        width, height = image_size(data)
    except (ValueError, struct.error) as error:
        raise FreeArtError(f"{path} is not a readable image: {error}") from error
    if width * height > MAX_PIXELS:
        raise FreeArtError(f"{path} claims {width} x {height} pixels, at most {MAX_PIXELS} pixels are read")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise FreeArtError(f"{path} is not a readable image")
    return image


def image_size(data: bytes) -> tuple[int, int]:
    """Width and height in the header of a PNG, JPEG or BMP. ValueError or struct.error otherwise."""
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        if b"IEND" not in data[-64:] and b"IEND" not in data:
            raise ValueError("it is cut off")
        return struct.unpack_from(">II", data, 16)
    if data.startswith(b"BM"):
        width, height = struct.unpack_from("<ii", data, 18)
        return abs(width), abs(height)
    if not data.startswith(b"\xff\xd8"):
        raise ValueError("expected PNG, JPEG or BMP")
    at = 2
    for _ in range(_MAX_SEGMENTS):  # to the frame's header (ITU-T T.81, B.1.1.3 and B.2.2)
        mark, kind, length = struct.unpack_from(">BBH", data, at)
        if mark != 0xFF:
            raise ValueError("its JPEG segments are broken")
        if kind == 0xFF:  # fill byte
            at += 1
        elif 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + length
    raise ValueError(f"its JPEG has no frame in {_MAX_SEGMENTS} segments")


def read_rgb(path: Path, root: Path | None = None) -> NDArray[np.uint8]:
    """(height, width, 3) RGB."""
    return np.ascontiguousarray(read_image(path, cv2.IMREAD_COLOR, root)[..., ::-1])


def read_labels(path: Path, root: Path | None = None) -> NDArray[np.uint8]:
    """(height, width) uint8 labels of a single-channel image."""
    return _read_channel(path, np.uint8, root)


def read_uint16(path: Path, root: Path | None = None) -> NDArray[np.uint16]:
    """(height, width) uint16 of a single-channel image."""
    return _read_channel(path, np.uint16, root)


def _read_channel(path: Path, kind: type[Any], root: Path | None) -> NDArray[Any]:
    image = read_image(path, cv2.IMREAD_UNCHANGED, root)
    if image.ndim != 2 or image.dtype != kind:
        raise FreeArtError(f"{path} has shape {image.shape} {image.dtype}, expected one channel of {kind.__name__}")
    return image


def encode_png(image: NDArray[Any]) -> bytes:
    """PNG bytes of a (height, width) uint8 or uint16 map or a (height, width, 3) RGB image.

    OpenCV's default settings are used: with any explicit compression level it tries all filters on each row, which
    takes twice the time and saves nothing on objects before a plain background.
    """
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    ok, data = cv2.imencode(".png", image)
    if not ok:
        raise FreeArtError(f"cannot encode an image of shape {image.shape} {image.dtype} as PNG")
    return bytes(data)
