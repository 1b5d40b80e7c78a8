"""Does a hostile submission stop the scorer, fool it, or slip past `validate`? A thousand spoiled ones, by a seed.

    .venv/bin/python -m benchmarks.submission_fuzz [--count 1000] [--seed 0]

takes an answer to a made-up sequence (with an asset, where the asset is to be spoiled), spoils a copy of it, packs
every third as a .zip, and runs `validate` and `score` on it as the commands do. Expected, and counted in
benchmarks/results/submission_fuzz.json: no error but one clear line, none that takes more than `LIMIT_S` seconds, no
number better than the unspoiled answer's, no row penalised without a reason from `validate`, and none the other way.

Answers are of two kinds. One is the truth: nothing beats it but a fault of the scorer. The other is somewhat wrong, and
gets those mutations alone that cannot bring a number nearer to the truth by luck.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.common import RESULTS, ROOT, run_cli, write_report
from freeart21.errors import FreeArtError
from freeart21.files.atomic import write_json
from freeart21.files.result import Method, write_method, write_result
from leaderboard import protocols
from leaderboard.archive import open_results
from leaderboard.protocols import strict2
from leaderboard.protocols.strict1 import Strict1
from leaderboard.rows import Row
from leaderboard.score import score_results
from leaderboard.scores_file import write_scores
from leaderboard.tables import print_scores
from leaderboard.validate import validate_results

sys.path.append(str(ROOT / "tests"))
from score_files import truths, write_asset, write_data
from synthetic_case import noisy_answer, pictures, truth_as_answer

LIMIT_S = 60.0
"""Seconds that one submission may take to be checked and scored; most take a tenth of one."""
SAMPLES = 500
"""Points on each surface: what is asked here is whether a number comes, and which."""
ROUNDING = 1e-5
"""By how much, absolute and relative, a number may be better than the unspoiled one's."""
SEQUENCE = "a"
Spoil = Callable[[np.random.Generator, Path], None]
"""Spoils the results folder in place."""


@dataclass(frozen=True)
class Mutation:
    """One way to spoil a submission."""

    name: str
    spoil: Spoil
    asset: bool = False
    """Whether the answer has an asset."""
    lucky: bool = False
    """Whether it may bring a number nearer to the truth: then the answer is the truth."""


@dataclass(frozen=True)
class Outcome:
    """What became of one spoiled submission."""

    index: int
    mutation: str
    packed: bool
    status: str
    """Of the row; 'refused' when the whole submission was."""
    text: str
    faults: tuple[str, ...]
    """What is wrong with the scorer; empty when it kept its word."""
    seconds: float


def main(count: int = 1000, seed: int = 0, out: Path = RESULTS / "submission_fuzz.json") -> int:
    """Spoil and score; exit code 1 when the scorer broke its word.

    Args:
        count: Submissions.
        seed: Of what is drawn.
        out: The JSON file.
    """
    console = Console()
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        fuzz = Fuzz(Path(place), seed)
        outcomes = [fuzz.run(i) for i in track(range(count), "Spoiling", console=console)]
    wrong = [o for o in outcomes if o.faults]
    broken = Counter(kind for o in wrong for kind in {fault.split(":")[0] for fault in o.faults})
    write_report(
        out,
        {"seed": seed, "samples": SAMPLES, "limit_s": LIMIT_S},
        summary={
            "submissions": count,
            "kinds": len(MUTATIONS),
            "tracebacks": broken["traceback"],
            "hangs": broken["hang"],
            "better_than_honest": broken["better"],
            "disagreements": broken["disagree"],
            "status": dict(sorted(Counter(o.status for o in outcomes).items())),
            "slowest_s": max(o.seconds for o in outcomes),
            "seconds": time.perf_counter() - began,
        },
        wrong=[asdict(o) for o in wrong],
        by_mutation=_by_mutation(outcomes),
    )
    for outcome in wrong:
        console.print(f"{outcome.index} {outcome.mutation}: {'; '.join(outcome.faults)}", markup=False, soft_wrap=True)
    console.print(f"{count} submissions, {len(wrong)} wrong, {time.perf_counter() - began:.0f} s")
    return int(bool(wrong))


def _by_mutation(outcomes: list[Outcome]) -> dict[str, dict[str, int]]:
    found: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        found.setdefault(outcome.mutation, Counter())[outcome.status] += 1
    return {name: dict(sorted(counts.items())) for name, counts in sorted(found.items())}


class Fuzz:
    """Spoiled submissions to one made-up sequence, each drawn from `[seed, index]` alone."""

    def __init__(self, place: Path, seed: int) -> None:
        """`place` is an empty folder to work in."""
        self.place, self.seed = place, seed
        few = partial(strict2.measure, constants=Strict1(samples=SAMPLES))
        self.rules = replace(protocols.PROTOCOLS["strict-2"], measure=few)
        whole = write_data(place / "whole")
        self.data = place / "data"
        for sub in ("sequences", "truth"):
            shutil.copytree(whole / sub / SEQUENCE, self.data / sub / SEQUENCE)
        body = json.loads((whole / "benchmark.json").read_text())
        write_json(self.data / "benchmark.json", {**body, "sequences": [SEQUENCE]})
        truth = truths()[SEQUENCE]
        self.honest: dict[tuple[bool, bool], Row] = {}
        for lucky, answer in ((True, truth_as_answer(truth)), (False, noisy_answer(truth))):
            for asset in (False, True):
                folder = self._honest(lucky, asset)
                write_result(folder / SEQUENCE, answer, renders=pictures(truth))
                write_method(folder, Method("honest", "none", {"a": 1}))
                if asset:
                    write_asset(folder / SEQUENCE / "asset", answer.articulation.joint, parts=answer.articulation)
                with self._few_samples():
                    row = score_results(folder, self.data, self.rules.name, limit_s=None).rows[0]
                assert row.status == "ok", row.reason
                self.honest[lucky, asset] = row

    def _honest(self, lucky: bool, asset: bool) -> Path:
        return self.place / f"honest-{'truth' if lucky else 'noisy'}-{'asset' if asset else 'files'}"

    @contextlib.contextmanager
    def _few_samples(self) -> Iterator[None]:
        known = protocols.PROTOCOLS[self.rules.name]
        protocols.PROTOCOLS[self.rules.name] = self.rules
        try:
            yield
        finally:
            protocols.PROTOCOLS[self.rules.name] = known

    def run(self, index: int) -> Outcome:
        """Spoil, check and score submission `index`."""
        rng = np.random.default_rng([self.seed, index])
        mutation = MUTATIONS[int(rng.integers(len(MUTATIONS)))]
        folder = self.place / f"work{index}" / "spoiled"
        shutil.copytree(self._honest(mutation.lucky, mutation.asset), folder, symlinks=True)
        given, packed = folder, False
        try:
            if mutation.name.startswith("zip"):
                given, packed = folder.with_suffix(".zip"), True
                _pack(folder, given)
                mutation.spoil(rng, given)
            else:
                mutation.spoil(rng, folder)
                if rng.random() < 1 / 3 and not any(path.is_symlink() for path in folder.rglob("*")):
                    given, packed = folder.with_suffix(".zip"), True
                    _pack(folder, given)
            return self._judge(index, mutation, given, packed)
        finally:
            shutil.rmtree(folder.parent)

    def _judge(self, index: int, mutation: Mutation, given: Path, packed: bool) -> Outcome:
        began, faults = time.perf_counter(), []
        status, text, row = "refused", "", None
        refusals: list[str] = []
        fatal: list[str] = []
        try:
            with _limit(), self._few_samples(), contextlib.redirect_stdout(io.StringIO()):
                try:
                    with open_results(given) as folder:
                        report = validate_results(folder, self.data)
                    fatal = [str(f) for f in report.faults if f.fatal and f.file.split("/")[0] == SEQUENCE]
                except FreeArtError as error:
                    refusals.append(str(error))
                try:
                    with open_results(given) as folder:
                        scores = score_results(folder, self.data, self.rules.name, limit_s=None)
                    row, status, text = scores.rows[0], scores.rows[0].status, scores.rows[0].reason
                    print_scores(scores, Console(file=io.StringIO()), everything=True)
                    write_scores(given.parent / "scores.json", scores)
                except FreeArtError as error:
                    text = str(error)
                    refusals.append(text)
        except _TooLongError:
            faults.append(f"hang: more than {LIMIT_S:g} s")
        except Exception:  # whatever else comes out is what we look for
            faults.append("traceback: " + " | ".join(traceback.format_exc().strip().splitlines()[-3:]))
        else:
            lines = [line for line in (*refusals, text, *fatal) if "\n" in line or not line.isprintable()]
            faults += [f"traceback: not one printable line: {line[:80]!r}" for line in lines]
            declared = row is not None and row.status == "failed" and not row.reason.startswith("asset: ")
            priced = row is not None and row.status != "ok" and not declared
            if len(refusals) == 1 or (row is not None and priced != bool(fatal)):
                faults.append(f"disagree: score says {status} {text[:80]!r}, validate {fatal[:2] or refusals}")
            if row is not None:
                faults += self._better(row, self.honest[mutation.lucky, mutation.asset])
        return Outcome(
            index, mutation.name, packed, status, text[:200], tuple(faults), round(time.perf_counter() - began, 3)
        )

    def _better(self, row: Row, honest: Row) -> list[str]:
        found = []
        for id, value in row.values.items():
            own = honest.values[id]
            if value is None or own is None:
                continue  # a number that the method says it lacks is nowhere counted
            up = self.rules.metric(id).direction == "up"
            room = ROUNDING * (1 + abs(own))
            if not np.isfinite(value) or (value > own + room if up else value < own - room):
                found.append(f"better: {id} is {value!r}, {own!r} without the mutation")
        return found


class _TooLongError(BaseException):
    """Not an Exception, which the scorer catches."""


@contextlib.contextmanager
def _limit() -> Iterator[None]:
    def late(*_: object) -> None:
        raise _TooLongError

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _pack(folder: Path, place: Path) -> None:
    with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, Path("spoiled") / path.relative_to(folder))


# ---- ways to spoil


def _one(rng: np.random.Generator, things: Any) -> Any:
    things = list(things)
    return things[int(rng.integers(len(things)))]


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())


Change = Callable[[np.random.Generator, bytearray], bytes | bytearray]
"""Spoils the bytes of a file."""


def _bytes(change: Change) -> Spoil:
    """Change the bytes of one of the files; of an archive its own."""

    def spoil(rng: np.random.Generator, folder: Path) -> None:
        path = _one(rng, _files(folder)) if folder.is_dir() else folder
        path.write_bytes(change(rng, bytearray(path.read_bytes())))

    return spoil


def _flip(rng: np.random.Generator, data: bytearray) -> bytearray:
    for _ in range(int(rng.integers(1, 9)) if data else 0):
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return data


def _flip_head(rng: np.random.Generator, data: bytearray) -> bytearray:
    for _ in range(4 if data else 0):
        data[int(rng.integers(min(len(data), 64)))] = int(rng.integers(256))
    return data


def _delete(rng: np.random.Generator, folder: Path) -> None:
    _one(rng, _files(folder)).unlink()


def _other_file(rng: np.random.Generator, folder: Path) -> None:
    files = _files(folder)
    shutil.copyfile(_one(rng, files), folder / "kept")
    (folder / "kept").replace(_one(rng, files))


def _folder_for_file(rng: np.random.Generator, folder: Path) -> None:
    path = _one(rng, _files(folder))
    path.unlink()
    path.mkdir()


def _file_for_folder(rng: np.random.Generator, folder: Path) -> None:
    path = _one(rng, sorted(p for p in folder.rglob("*") if p.is_dir()))
    shutil.rmtree(path)
    path.write_bytes(b"x")


def _huge(rng: np.random.Generator, folder: Path) -> None:
    path = _one(rng, [p for p in _files(folder) if p.suffix in (".json", ".png", ".ply", ".npz")])
    os.truncate(path, 1 << 31)


HOSTILE = (
    *(None, True, False, -1, 0, 1e308, -1e308, 10**400, "", "x", [], {}, [None], [[[]]], {"a": {"b": []}}, 2**63),
    *("\ud800", "\x1b[31mred\x1b[0m", "[red]boo[/]", "[/]", "a\nb", "\u202eabc", "x" * 100_000, "../../etc/passwd"),
    *("NaN", "1e999", "1", [1, "a"], [[1, 2], [3]], [1e308] * 3, ["nan"] * 16, [True] * 16, [[1, 0]] * 16),
)
TOKENS = ("NaN", "Infinity", "-Infinity", "1e400", "1E+999999999", "-0", "[" * 3000 + "]" * 3000, "9" * 6000, "{")


def _json(file: str) -> Spoil:
    """Remove or replace one value anywhere in a JSON file, or add one."""
    names = ("x", "lacks", "anchor", "trust", "joint_std", "seen", "schema", "\ud800", "a" * 5000)

    def spoil(rng: np.random.Generator, folder: Path) -> None:
        path = folder / file
        body = json.loads(path.read_text())
        node: Any = body
        key: Any = _one(rng, node)
        while isinstance(node[key], dict | list) and len(node[key]) and rng.random() < 0.6:
            node = node[key]
            key = _one(rng, node) if isinstance(node, dict) else int(rng.integers(len(node)))
        way = int(rng.integers(4))
        if way == 0:
            del node[key]
        elif way == 1:
            node[key] = "TOKEN"
        else:
            node[_one(rng, names) if way == 2 and isinstance(node, dict) else key] = _one(rng, HOSTILE)
        path.write_text(json.dumps(body).replace('"TOKEN"', _one(rng, TOKENS)))

    return spoil


def _field(file: str, *choices: tuple[str, Iterable[Any]], within: str | None = None) -> Spoil:
    """Give a field of a JSON file, or of the object `within` it, one of the values that belong to it."""
    pairs = [(name, value) for name, values in choices for value in values]

    def spoil(rng: np.random.Generator, folder: Path) -> None:
        path = folder / file
        body = json.loads(path.read_text())
        name, value = _one(rng, pairs)
        (body[within] if within else body)[name] = value
        path.write_text(json.dumps(body))

    return spoil


PREDICTION, METHOD, ASSET = f"{SEQUENCE}/prediction.json", "method.json", f"{SEQUENCE}/asset/asset.json"
ANSWER_FIELDS: dict[str, tuple[Any, ...]] = {
    "states": ([0] * 15, [0] * 17, [[0]] * 16, ["0"] * 16, [1e300] * 16, [2e6] * 16),
    "seen": ([[True, 2]] * 16, [[0, 0]] * 16, [[1e308, -1]] * 16),
    "state_std": ([None] * 16, [-1] * 16, [[1]] * 16),
    "anchor": (15, 16, -16, 1.5, "3", 10**30),
    "trust": ({"verdict": "sound", "reasons": ["x"]}, {"verdict": "doubtful", "reasons": ["a\x1b"]}),
    "joint_std": ({"axis_rad": -1}, {"axis_rad": "x"}, {"pivot_m": 1e400}),
    "seconds": ({"a": True}, {"a": 10**400}, {"a": -1e308}, {"\x1b": 1}),
}
"""Fields of prediction.json to values that each of them gets beside HOSTILE."""
JOINT_VALUES = ("screw", [0, 0, 0], [1, 1, 1], [1e200] * 3, [1, 0], None, "revolute", [[1, 0, 0]], [None] * 3, 7)
METHOD_VALUES = (
    *("[bold]x", "[link=file:///etc]x[/link]", "<script>alert(1)</script>", "\x00\x07\x08", "{0}%s", "😀" * 400),
    *(["poses"], ["states", "poses", "masks", "meshes", "renders"], ["nothing"], "poses", [["poses"]], {"poses": 1}),
)
NO_JSON = (
    *(b"[]", b"null", b"7", b'"x"', b"\xff\xfe{\x00}\x00", b"{" * 100_000, b"[" * 100_000, b"\x00" * 100, b"{}"),
    *(b'{"a":' * 50_000, b'{"schema": "freeart21/prediction/1"}', b'{"schema": 1}', b"\xef\xbb\xbf{}"),
)
_TURNED = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
ASSET_FIELDS: dict[str, tuple[Any, ...]] = {
    "urdf": ("../prediction.json", "/etc/passwd", "none.urdf", "", ".", "meshes", 5),
    "joint": ("none", "", None, "base", ["lid"]),
    "reference_link": ("lid", "none", None),
    "moving_link": ("base", "none", ""),
    "T_canonical_reference": (_TURNED, [[1]], np.zeros((4, 4)).tolist(), [[1e300] * 4] * 4, None),
    "state_zero": (1e300, "0", None, 3.0, -1e6),
    "held": ({"lid": 1.0}, {"none": 1}, [1], {"lid": "x"}),
    "scale": (2.0, 0, -1, 1e300, "1", 1e-9),
}


def _not_json(rng: np.random.Generator, folder: Path) -> None:
    (folder / _one(rng, (PREDICTION, METHOD))).write_bytes(_one(rng, NO_JSON))


def _npz(rng: np.random.Generator, folder: Path) -> None:
    path = folder / SEQUENCE / "poses.npz"
    with np.load(path) as read:
        arrays = {name: read[name] for name in read}
    name = _one(rng, ("T_camera_reference", "T_camera_moving", "covariances"))
    given, n = arrays.get(name, np.zeros((16, 2, 6, 6))), 16
    ways: tuple[Callable[[], Any], ...] = (
        lambda: given[:-1],
        lambda: np.concatenate([given, given]),
        lambda: given.reshape(-1),
        lambda: given.astype(np.float16) * np.float16(1e4),
        lambda: np.full(given.shape, np.nan),
        lambda: np.full(given.shape, 1e308),
        lambda: np.zeros(given.shape),
        lambda: np.zeros((0, 4, 4)),
        lambda: np.array(1.0),
        lambda: given.astype(complex) * 1j,
        lambda: given.astype(bool),
        lambda: given.astype("U8"),
        lambda: np.zeros((n, 4, 4), [("a", "f4")]),
        lambda: np.array([{"a": 1}] * n, object),
        lambda: np.array([_Bomb()] * n, object),
        lambda: given * -1,
        lambda: given * 1000,
        lambda: np.swapaxes(given, -1, -2),
        lambda: np.zeros((n, 4, 4), "M8[s]"),
        lambda: np.asfortranarray(given),
        lambda: given.astype(">f8"),
        lambda: given + 1e-3,
        lambda: np.full(given.shape, -1e30),
    )
    arrays[name] = _one(rng, ways)()
    np.savez_compressed(path, **arrays)


class _Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.abort, ()


def _npz_raw(rng: np.random.Generator, folder: Path) -> None:
    """Headers that promise what is not there, archives in archives, bombs."""
    path = folder / SEQUENCE / "poses.npz"
    shape = _one(rng, ("(16, 4, 4)", "(10000000000, 4, 4)", "(-1, 4, 4)", "(16,", "(0,)", "(2**40,)", "(1,)*99999"))
    kind = _one(rng, ("<f8", "|O", "<f99", "|V100000000", "<U999999", "[('a','<f8')]", "<i8"))
    order = _one(rng, ("False", "True", "7"))
    head = f"{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}"
    head = head + " " * (-len(head) % 64) + "\n"
    major = int(_one(rng, (1, 2, 3, 9)))
    size = struct.pack("<H" if major == 1 else "<I", len(head))
    npy = b"\x93NUMPY" + bytes([major, 0]) + size + head.encode() + rng.bytes(_one(rng, (0, 8, 2048)))
    if rng.random() < 0.2:
        npy += bytes(300 << 20)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("T_camera_reference.npy", "T_camera_moving.npy", _one(rng, ("covariances.npy", "../x.npy", "x"))):
            archive.writestr(name, npy)


def _mask(rng: np.random.Generator, folder: Path) -> None:
    import cv2

    place = folder / SEQUENCE / _one(rng, ("part_mask", "renders"))
    path = _one(rng, sorted(place.glob("*.png")))
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    ways = (
        image[:-1],
        np.vstack([image, image]),
        image.astype(np.uint16) * 257,
        np.full(image.shape[:2], 3, np.uint8),
        np.full(image.shape[:2], 255, np.uint8),
        np.zeros((*image.shape[:2], 4), np.uint8),
        np.zeros((*image.shape[:2], 3), np.uint8),
        np.zeros((1, 1), np.uint8),
        np.zeros((4000, 4000), np.uint8),
    )
    end = _one(rng, (".png", ".png", ".png", ".jpg", ".bmp", ".tiff"))
    made = _one(rng, ways)
    if made.dtype != np.uint8 or (made.ndim == 3 and made.shape[2] == 4):
        end = ".png"
    path.write_bytes(cv2.imencode(end, made)[1].tobytes())


def _png_raw(rng: np.random.Generator, folder: Path) -> None:
    """Headers of impossible pictures, and chunks that lie."""
    place = folder / SEQUENCE / _one(rng, ("part_mask", "renders"))
    path = _one(rng, sorted(place.glob("*.png")))
    side = [int(_one(rng, (0, 1, 32, 40, 65_536, 2**31 - 1, 2**32 - 1))) for _ in range(2)]
    if rng.random() < 0.5:
        side = [40, 32]
    depth, colour, interlaced = _one(rng, (1, 2, 8, 16, 99)), _one(rng, (0, 2, 3, 4, 6, 99)), _one(rng, (0, 1, 9))
    head = struct.pack(">IIBBBBB", *side, depth, colour, 0, 0, interlaced)
    data = zlib.compress(bytes(int(_one(rng, (0, 100, 41 * 32, 100 << 20)))))
    chunks = [(b"IHDR", head), (b"IDAT", data), (b"IEND", b"")]
    if rng.random() < 0.3:
        chunks.insert(1, (_one(rng, (b"PLTE", b"tRNS", b"zTXt", b"iCCP", b"acTL", b"IHDR")), rng.bytes(600)))
    body = b"\x89PNG\r\n\x1a\n"
    for name, inside in chunks:
        size = len(inside) if rng.random() < 0.9 else int(rng.integers(2**32))
        body += struct.pack(">I", size) + name + inside + struct.pack(">I", zlib.crc32(name + inside))
    path.write_bytes(body)


def _ply(rng: np.random.Generator, folder: Path) -> None:
    path = folder / SEQUENCE / "parts" / f"{_one(rng, ('reference', 'moving'))}.ply"
    value = _one(rng, ("nan", "1e300", "-inf", "1e7", "x", "1e38", "0x10", "", "1_000"))
    index = _one(rng, ("-1", "3", "99999999999", "2147483648", "0.5", "x", "2"))
    corners, faces = (
        _one(rng, ("3", "4", "2", "255", "-3")),
        _one(rng, ("1", "2", "0", "-1", "99999999999", "1e3", "x")),
    )
    points = _one(rng, ("3", "2", "-3", "99999999999999", "x", "0"))
    kind = _one(rng, ("ascii", "binary_little_endian", "binary_big_endian", "pdp_endian", ""))
    number = _one(rng, ("float", "double", "uchar", "int", "float128", "list"))
    end = _one(rng, ("end_header\n", "end_header\n", "end_header", ""))
    text = (
        f"ply\nformat {kind} 1.0\nelement vertex {points}\nproperty {number} x\nproperty float y\nproperty float z\n"
        f"element face {faces}\nproperty list uchar int vertex_indices\n{end}0 0 {value}\n1 0 0\n0 1 0\n"
        f"{corners} 0 1 {index}\n"
    )
    path.write_bytes(text.encode() + (rng.bytes(200) if rng.random() < 0.3 else b""))


def _mesh_values(rng: np.random.Generator, folder: Path) -> None:
    """A binary part with vertices or faces that cannot be."""
    path = folder / SEQUENCE / "parts" / f"{_one(rng, ('reference', 'moving'))}.ply"
    head, mark, body = path.read_bytes().partition(b"end_header\n")
    data = bytearray(body)
    at = int(rng.integers(0, 20)) * 8 if rng.random() < 0.6 else len(data) - 13 * int(rng.integers(1, 10)) + 1
    value = _one(rng, (np.nan, np.inf, 1e300, -1e300, 1e7, 1e6, 5e-324))
    data[at : at + 8] = struct.pack("<d", value)
    path.write_bytes(head + mark + bytes(data[: len(body)]))


def _no_surface(rng: np.random.Generator, folder: Path) -> None:
    path = folder / SEQUENCE / "parts" / f"{_one(rng, ('reference', 'moving'))}.ply"
    rows = _one(rng, ("0 0 0\n0 0 0\n0 0 0", "0 0 0\n1 0 0\n2 0 0", "0 0 0\n1e-200 0 0\n0 1e-200 0"))
    faces = _one(rng, ("1", "0"))
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n{rows}\n"
        + ("3 0 1 2\n" if faces == "1" else "")
    )


def _link(rng: np.random.Generator, folder: Path) -> None:
    path = _one(rng, [*_files(folder), folder / SEQUENCE, folder / SEQUENCE / "parts"])
    target = _one(rng, ("/etc/passwd", "/", "..", ".", path.name, "nowhere", "../../..", "/dev/zero", "/proc/self/mem"))
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    path.symlink_to(target)


def _fifo(rng: np.random.Generator, folder: Path) -> None:
    path = _one(rng, _files(folder))
    path.unlink()
    os.mkfifo(path)


def _more_files(rng: np.random.Generator, folder: Path) -> None:
    names = ("x" * 200, "\x1b[2Jq", "a b", "🙂", "prediction.json.bak", "-rf", "b\nc", "%s", "[red]")
    for _ in range(3):
        (folder / _one(rng, (".", SEQUENCE))).joinpath(_one(rng, names)).mkdir(exist_ok=True)


def _declared(rng: np.random.Generator, folder: Path) -> None:
    body: dict[str, Any] = {
        "schema": "freeart21/prediction/1",
        "status": _one(rng, ("failed", "failed", "great", None, 1)),
    }
    body |= {
        "stage": _one(rng, HOSTILE),
        "reason": _one(rng, HOSTILE),
        "seconds": _one(rng, (None, {"a": 1}, *HOSTILE)),
    }
    (folder / SEQUENCE / "prediction.json").write_text(json.dumps(body))


# of the asset


def _urdf(rng: np.random.Generator, folder: Path) -> None:
    path = folder / SEQUENCE / "asset" / "made.urdf"
    text = path.read_text()
    bomb = "".join(f'<!ENTITY b{i} "{f"&b{i - 1};" * 10}">' for i in range(1, 12))
    deep = "<link>" * 20_000 + "</link>" * 20_000
    mesh = 'filename="meshes/lid.ply"'
    ways: tuple[tuple[str, str], ...] = (
        ("<robot", f'<!DOCTYPE x [<!ENTITY b0 "lol">{bomb}]><robot note="&b11;"'),
        ("<robot", '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot note="&e;"'),
        ("</robot>", f"{deep}</robot>"),
        ("</robot>", ""),
        (mesh, 'filename="/etc/passwd"'),
        (mesh, 'filename="../../../../../../etc/passwd"'),
        (mesh, 'filename="package://x/lid.ply"'),
        (mesh, 'filename="file:///etc/passwd"'),
        (mesh, 'filename="meshes/lid.exe"'),
        (mesh, 'filename=""'),
        (mesh, f'{mesh} scale="0 0 0"'),
        (mesh, f'{mesh} scale="-1 1 1"'),
        (mesh, f'{mesh} scale="nan 1 1"'),
        (mesh, f'{mesh} scale="1e308 1e308 1e308"'),
        (mesh, f'{mesh} scale="1000 1000 1000"'),
        ('<child link="lid"/>', '<child link="base"/>'),
        ('<parent link="base"/>', '<parent link="lid"/>'),
        ('<parent link="base"/>', '<parent link="nobody"/>'),
        ("</robot>", '<joint name="back" type="fixed"><parent link="lid"/><child link="base"/></joint></robot>'),
        ("</robot>", '<link name="free"/></robot>'),
        ("</robot>", '<link name="lid"/></robot>'),
        ("</robot>", "".join(f'<link name="l{i}"/>' for i in range(300)) + "</robot>"),
        ('type="revolute"', 'type="ball"'),
        ('type="revolute"', 'type="fixed"'),
        ('type="revolute"', 'type="floating"'),
        ('type="revolute"', 'type="continuous"'),
        ('lower="-2.0"', 'lower="nan"'),
        ('lower="-2.0"', 'lower="1e308"'),
        ('upper="2.0"', 'upper="-3"'),
        ('upper="2.0"', 'upper="inf"'),
        ('effort="1"', 'effort="x"'),
        ("<limit", "<mimic joint='lid'/><limit"),
        ("<axis", '<axis xyz="0 0 0"/><axis'),
        ('rpy="0.3 -0.2 0.5"', 'rpy="nan 0 0"'),
        ('rpy="0.3 -0.2 0.5"', 'rpy="1e308 0 0"'),
        ('<mass value="1"/>', '<mass value="-1"/>'),
        ('<mass value="1"/>', '<mass value="1e300"/>'),
        ('<mass value="1"/>', '<mass value="1e-300"/>'),
        ('ixx="1"', 'ixx="-1"'),
        ('ixx="1"', 'ixx="nan"'),
        ('<box size="0.3 0.2 0.1"/>', '<box size="0 0 0"/>'),
        ('<box size="0.3 0.2 0.1"/>', '<box size="nan 1 1"/>'),
        ('<box size="0.3 0.2 0.1"/>', '<cylinder radius="-1" length="1e300"/>'),
        ('<box size="0.3 0.2 0.1"/>', '<mesh filename="meshes/base.ply"/>'),
        ("<visual>", '<visual><geometry><sphere radius="1e30"/></geometry></visual><visual>'),
        ("<visual>", "<visual/><visual>"),
        ('name="base"', 'name=""'),
        ('name="base"', 'name="\U0001f642 [red]&#10;x"'),
        ('name="lid"', 'name="world"'),
        ('encoding="utf-8"', "x"),
    )
    old, new = _one(rng, ways)
    path.write_text(text.replace(old, new))


def _asset_mesh(rng: np.random.Generator, folder: Path) -> None:
    asset = folder / SEQUENCE / "asset"
    name = _one(rng, ("obj", "stl", "glb", "dae", "off", "3mf", "xyz", "ply"))
    obj = _one(
        rng,
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n",
            "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            "v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            "v 0 0 0\nf 1/1/1/1 1//// 1\n",
            "v 0 0\nf 0 0 0\n",
            "mtllib ../../../../etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            "mtllib " + "x" * 10_000 + "\nusemtl q\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            "f " + "1 " * 10_000 + "\n",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "f 1 2 3\n" * 3000,
            "",
            "\x00\xff" * 500,
            "solid x\nfacet normal 0 0 0\nouter loop\nvertex 0 0 nan\nendloop\nendfacet\nendsolid",
        ),
    )
    (asset / "meshes" / f"lid.{name}").write_text(obj)
    path = asset / "made.urdf"
    path.write_text(path.read_text().replace('meshes/lid.ply"', f'meshes/lid.{name}"'))


def _asset_effects(rng: np.random.Generator, folder: Path) -> None:
    body = {
        "schema": _one(rng, ("freeart21/effects/1", "freeart21/effects/9", None)),
        "urdf_sha256": _one(rng, ("0" * 64, None, 7)),
        "baseline": _one(rng, (None, {}, {"joint_friction": 1.0}, [])),
        "joints": _one(
            rng,
            (
                {"lid": [{"effect": "viscous_damping", "parameters": {"coefficient": {"value": 1e300, "unit": "x"}}}]},
                {"lid": [{"effect": "__class__", "parameters": {}}]},
                {"lid": [{"effect": "../../os", "parameters": {}}]},
                {"none": []},
                {"lid": None},
                [],
                {"lid": [{}] * 1000},
            ),
        ),
    }
    (folder / SEQUENCE / "asset" / "effects.json").write_text(json.dumps(body))


def _asset_folder(rng: np.random.Generator, folder: Path) -> None:
    asset = folder / SEQUENCE / "asset"
    way = int(rng.integers(6))
    if way == 0:
        shutil.rmtree(asset)
        asset.write_text("an asset")
    elif way == 1:
        shutil.copyfile(asset / "made.urdf", asset / "other.urdf")
        (asset / "asset.json").unlink()
    elif way == 2:
        (asset / "made.xml").write_text("<mujoco><include file='/etc/passwd'/></mujoco>")
    elif way == 3:
        (asset / "made.xml").write_text("<mujoco>" + "<body>" * 5000)
    elif way == 4:
        os.truncate(asset / "meshes" / "lid.ply", 2 << 30)
    else:
        (asset / "made.urdf").write_bytes((asset / "made.urdf").read_text().encode("utf-16"))


# of the archive


ENTRIES = (
    *("../../outside", "/tmp/outside", "spoiled/../../x", "spoiled\\..\\x", "C:\\x", "C:x", "", ".", "a/" * 50 + "x"),
    *(
        "x" * 300,
        "b\nc",
        "\x1b[2J",
        "spoiled/a/prediction.json",
        "spoiled/a/prediction.json/",
        "__MACOSX/._x",
        "é" * 150,
    ),
)


def _zip_entry(rng: np.random.Generator, path: Path) -> None:
    name = _one(rng, ENTRIES)
    with zipfile.ZipFile(path, "a") as archive:
        info = zipfile.ZipInfo(name)
        info.external_attr = int(_one(rng, (0o100644, 0o120777, 0o10644, 0o20666, 0o40755, 0))) << 16
        archive.writestr(info, b"/etc/passwd")


def _zip_bomb(rng: np.random.Generator, path: Path) -> None:
    size = int(_one(rng, (64 << 20, 1100 << 20)))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("spoiled/a/zeros", "w") as file:
        for _ in range(size >> 20):
            file.write(bytes(1 << 20))
    data = bytearray(path.read_bytes())
    if rng.random() < 0.5:  # its size said to be small
        at = data.rfind(b"PK\1\2")
        data[at + 24 : at + 28] = struct.pack("<I", 10)
    path.write_bytes(data)


def _zip_bytes(rng: np.random.Generator, data: bytearray) -> bytearray:
    begin = data.find(b"PK\1\2") if rng.random() < 0.7 else 0
    for _ in range(int(rng.integers(1, 12))):
        data[int(rng.integers(begin, len(data)))] = int(rng.integers(256))
    return data


def _zip_cut(rng: np.random.Generator, data: bytearray) -> bytes | bytearray:
    cut = int(rng.integers(len(data)))
    empty = base64.b64decode("UEsFBgAAAAAAAAAAAAAAAAAAAAAAAA==")
    return _one(rng, (data[:cut], data[cut:], b"", empty, rng.bytes(2000)))


def _zip_record(mark: bytes, *fields: tuple[int, bytes]) -> Spoil:
    """Overwrite a field, at its offset, of the last record that begins with `mark`."""

    def change(rng: np.random.Generator, data: bytearray) -> bytearray:
        field, value = _one(rng, fields)
        at = data.rfind(mark) + field
        data[at : at + len(value)] = value
        return data

    return _bytes(change)


_ALL_ONES = b"\xff" * 4
_METHODS = ((10, 99), (10, 12), (10, 14), (8, 1), (8, 64), (10, 0), (24, 5), (20, 7), (42, 9))
"""Offset in an entry of the directory, and a number: packed by another method, encrypted, of another size."""
MUTATIONS = (
    *(
        Mutation(f"{n} {w}", _bytes(change), a, True)
        for n, change in (("flipped bits", _flip), ("changed head", _flip_head))
        for w, a in (("files", False), ("asset", True))
    ),
    Mutation("truncated", _bytes(lambda rng, data: data[: int(rng.integers(len(data) + 1))]), lucky=True),
    Mutation("truncated with asset", _bytes(lambda rng, data: data[: int(rng.integers(len(data) + 1))]), True, True),
    Mutation("garbage", _bytes(lambda rng, _: rng.bytes(int(rng.integers(0, 5000)))), True),
    Mutation("appended bytes", _bytes(lambda rng, data: data + rng.bytes(int(rng.integers(1, 2000)))), lucky=True),
    Mutation("missing file", _delete, True),
    Mutation("another file's bytes", _other_file, True, True),
    Mutation("folder for a file", _folder_for_file, True),
    Mutation("file for a folder", _file_for_folder, True),
    Mutation("huge file", _huge),
    Mutation("prediction.json", _json(PREDICTION), lucky=True),
    *(Mutation(n, _field(PREDICTION, (n, (*HOSTILE, *values)))) for n, values in ANSWER_FIELDS.items()),
    Mutation(
        "joint",
        _field(
            PREDICTION,
            *((n, JOINT_VALUES) for n in ("type", "axis", "pivot", "limits", "name", "lower", "upper")),
            within="joint",
        ),
        lucky=True,
    ),
    Mutation("declared failure", _declared),
    Mutation("not JSON", _not_json),
    Mutation("method.json", _json(METHOD)),
    Mutation(
        "words of the method",
        _field(
            METHOD,
            *((n, (*HOSTILE, *METHOD_VALUES)) for n in ("name", "code", "hardware", "settings", "lacks", "schema")),
        ),
    ),
    Mutation("poses.npz", _npz, lucky=True),
    Mutation("poses.npz, raw", _npz_raw, lucky=True),
    Mutation("picture", _mask, lucky=True),
    Mutation("PNG, raw", _png_raw, lucky=True),
    Mutation("part as text", _ply),
    Mutation("part's numbers", _mesh_values, lucky=True),
    Mutation("part without a surface", _no_surface),
    Mutation("link", _link, True),
    Mutation("pipe", _fifo),
    Mutation("more in the folder", _more_files),
    Mutation("URDF", _urdf, True, True),
    Mutation("asset.json", _json(ASSET), True, True),
    Mutation("asset.json's fields", _field(ASSET, *ASSET_FIELDS.items()), True, True),
    Mutation("mesh of the asset", _asset_mesh, True, True),
    Mutation("effects.json", _asset_effects, True),
    Mutation("asset folder", _asset_folder, True),
    Mutation("zip: entry", _zip_entry),
    Mutation("zip: bomb", _zip_bomb),
    Mutation("zip: bytes", _bytes(_zip_bytes), lucky=True),
    Mutation("zip: cut", _bytes(_zip_cut)),
    Mutation(
        "zip: directory",
        _zip_record(b"PK\5\6", (8, _ALL_ONES), (12, _ALL_ONES), (12, b"\0\0\0\x7f"), (16, _ALL_ONES)),
    ),
    Mutation("zip: method", _zip_record(b"PK\1\2", *((at, struct.pack("<H", value)) for at, value in _METHODS))),
)
"""Each is as likely as any other."""


if __name__ == "__main__":
    run_cli(main)
