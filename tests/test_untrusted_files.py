"""Files of users are opened in one place, `freeart21.files.checked`, whatever they are."""

from __future__ import annotations

import io
import os
import resource
import shutil
import signal
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command
from refusal import assert_refused
from score_files import submit, truths, write_asset, write_data
from test_measured import write as write_measured_set

from freeart21.files import checked
from freeart21.files.verify import verify
from leaderboard.validate import validate_results

# ---- hostile files, before every command that reads one of their kind

BOUND_S = 60
"""Reading forever is what this ends; reading takes milliseconds."""
BOUND_BYTES = 400 << 20


def png(width: int, height: int) -> bytes:
    """A PNG that says to be that large, and holds a kilobyte of it."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


def npz(shape: tuple[int, ...] = (10**9, 4, 4), claimed: int | None = None) -> bytes:
    """Arrays whose headers claim `shape`, of 64 bytes each, or whose list of entries claims `claimed` bytes."""
    header, packed = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(packed, "w") as archive:
        for key in ("T_camera_reference", "T_camera_moving", "seen", "covariances"):
            archive.writestr(f"{key}.npy", header.getvalue() + bytes(64))
    data = bytearray(packed.getvalue())
    if claimed is not None:
        struct.pack_into("<I", data, data.index(b"PK\1\2") + 24, claimed)
    return bytes(data)


PLY_LIE = b"""ply
format %s 1.0
element vertex 4000000000
property double x
property double y
property double z
element face 4000000000
property list uchar int vertex_indices
end_header
0 0 0
"""
Spoil = Callable[[Path], object]


def written(data: bytes) -> Spoil:
    return lambda path: path.write_bytes(data)


def cut_off(path: Path) -> None:
    path.write_bytes(png(40, 32)[:60])


def bind(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(os.path.relpath(path))  # a socket's path has at most 107 bytes


NO_FILE: dict[str, Spoil] = {
    "pipe": os.mkfifo,
    "link to /dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "link that leads out": lambda path: path.symlink_to(path.with_name(f".honest {path.name}").resolve()),
    "link to itself": lambda path: path.symlink_to(path.name),
    "socket": bind,
    "folder": lambda path: path.mkdir(),
    "empty": written(b""),
}
KINDS: dict[str, dict[str, Spoil]] = {
    ".json": {
        "deep lists": written(b"[" * 20_000),
        "deep objects": written(b'{"schema": ' * 900 + b"1" + b"}" * 900),
        "digits": written(b'{"schema": ' + b"9" * 6000 + b"}"),
        "cut off": written(b'{"schema": "freeart21/'),
        "no text": written(b'{"schema": "\xff"}'),
    },
    ".png": {
        "huge": written(png(100_000, 100_000)),
        "large": written(png(16_000, 16_000)),
        "cut off": cut_off,
        "noise": written(bytes(range(256))),
    },
    ".npz": {
        "rows that it has not": written(npz()),
        "no rows of nothing": written(npz((-1, -4))),
        "bomb": written(npz((4,), 3 << 30)),
        "cut off": written(npz()[:300]),
    },
    ".ply": {
        "ASCII lie": written(PLY_LIE % b"ascii"),
        "binary lie": written(PLY_LIE % b"binary_little_endian"),
        "cut off": written(PLY_LIE[:40]),
    },
    ".csv": {"no text": written(b"t_s,q\n\xff\xfe\0"), "noise": written(bytes(range(256)) * 9)},
    ".txt": {"noise": written(bytes(range(256)))},
    ".urdf": {"entities": written(b'<!DOCTYPE a [<!ENTITY b "c">]><robot>&b;</robot>'), "cut off": written(b"<robot")},
}
MADE = {"data", "results", "asset", "measured", "pictures", "data.key"}
SEQUENCE, TRUTH, RESULT = "data/sequences/b", "data/truth/b", "results/b"
COMMANDS = {
    "view {0}/data/sequences/b --out {0}/out": ("sequence.json", "rgb/00003.png", "depth/00001.png", "queries.json"),
    "reconstruct {0}/data/sequences/b --out {0}/out": ("sequence.json", "rgb/00015.png", "mask/00001.png"),
    "convert {0}/data/sequences/b --out {0}/out --to official": ("sequence.json", "rgb/00003.png", "depth/00001.png"),
    "pack {0}/data --out {0}/out --public": ("sequence.json", "rgb/00003.png", "mask/00001.png"),
    "view {0}/data/truth/b --out {0}/out": ("truth.json", "poses.npz", "parts/moving.ply", "part_mask/00001.png"),
    "export {0}/results/b --out {0}/out": ("prediction.json", "poses.npz", "parts/moving.ply"),
    "view {0}/results/b --out {0}/out": ("prediction.json", "poses.npz", "parts/moving.ply", "part_mask/00001.png"),
    "convert {0}/pictures --out {0}/out --to native": (
        "rgb/00001.png",
        "depth/00001.png",
        "masks/00001.png",
        "cam_K.txt",
    ),
    "view {0}/asset --out {0}/out": ("asset.json", "made.urdf"),
    "check-asset {0}/asset": ("asset.json",),
    "gap {0}/asset {0}/measured --out {0}/out": ("measured.json", "run_0.csv"),
    "measure {0}/measured/run_0.csv --asset {0}/asset --out {0}/out": ("run_0.csv",),
}


def hostile_cases() -> list:
    """All kinds of hostile files for one file of each suffix, and three, in turn, for every other file of a command."""
    cases, suffixes = [], set()
    for number, (command, file) in enumerate((command, file) for command, files in COMMANDS.items() for file in files):
        suffix = Path(file).suffix
        kinds = [*NO_FILE, *KINDS[suffix]]
        if suffix in suffixes:
            kinds = [kinds[(3 * number + k) % len(kinds)] for k in range(3)]
        suffixes.add(suffix)
        for kind in kinds:
            if not (command.startswith("measure") and kind == "link that leads out"):  # a user may name a link
                cases.append(pytest.param(command, file, kind, id=f"{' '.join(command.split()[:2])} {file} {kind}"))
    return cases


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder, results, an asset, a measured set and a camera's pictures, all well."""
    base = tmp_path_factory.mktemp("f")
    write_data(base / "data")
    for name, truth in truths().items():
        submit(base / "results" / name, truth)
    (base / "asset").mkdir()
    write_asset(base / "asset", truths()["a"].articulation.joint)
    write_measured_set(base / "measured")
    for sub, source in (("rgb", "rgb"), ("depth", "depth"), ("masks", "mask")):
        (base / "pictures" / sub).mkdir(parents=True)
        for i in range(3):
            shutil.copy(base / SEQUENCE / source / f"{i:05d}.png", base / "pictures" / sub)
    (base / "pictures" / "cam_K.txt").write_text("500 0 20\n0 500 16\n0 0 1\n")
    return base


@contextmanager
def spoilt(path: Path, kind: str) -> Iterator[None]:
    """The file `path` in another's place; time and memory are bounded meanwhile."""

    def end(*_: object) -> None:
        raise AssertionError(f"more than {BOUND_S} s")

    aside = path.parents[1] / f".honest {path.name}"
    path.replace(aside)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    handler = signal.signal(signal.SIGALRM, end)
    signal.alarm(BOUND_S)
    try:
        {**NO_FILE, **KINDS[path.suffix]}[kind](path)
        yield
        assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < BOUND_BYTES
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink(missing_ok=True)
        aside.replace(path)


@pytest.mark.parametrize("command, file, kind", hostile_cases())
def test_a_hostile_file_costs_one_line(honest, capfd, command, file, kind):
    words = command.format(honest).split()
    source = Path(words[1]) if Path(words[1]).is_dir() else Path(words[1]).parent
    source = honest / SEQUENCE if source == honest / "data" and file != "truth.json" else source
    source = honest / TRUTH if file == "truth.json" else source
    source = honest / "measured" if words[0] == "gap" else source
    with spoilt(source / file, kind):
        code, _, err = run_command(capfd, *words)
    left = [path for path in honest.iterdir() if path.name not in MADE]
    for path in left:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    lines = err.splitlines()
    assert code == 1 and len(lines) == 1 and lines[0].startswith("freeart21: ") and len(lines[0]) < 600, lines
    assert Path(file).name in lines[0] or source.name in lines[0]
    assert not left, "nothing is written"


def test_a_long_list_of_entries_is_refused_also_when_its_end_holds_the_mark_of_another(tmp_path):
    end = struct.pack("<4s4s2H2IH", b"PK\5\6", b"PK\5\6", 0, 0, 2 << 20, 0, 0)
    (tmp_path / "a.npz").write_bytes(bytes(2 << 20) + end)
    assert_refused(r"a\.npz has a directory of 2097152 bytes", checked.read_npz, tmp_path / "a.npz")


def test_a_jpeg_of_fill_bytes_is_not_walked_through():
    with pytest.raises(ValueError, match="no frame in 65536 segments"):
        checked.image_size(b"\xff\xd8" + b"\xff" * (1 << 17))


@pytest.mark.parametrize(
    "file, kind",
    [
        *(("prediction.json", kind) for kind in (*NO_FILE, *KINDS[".json"])),
        *(("poses.npz", kind) for kind in KINDS[".npz"]),
        *(("parts/moving.ply", kind) for kind in KINDS[".ply"]),
        *(("part_mask/00001.png", kind) for kind in KINDS[".png"]),
    ],
)
def test_a_hostile_file_of_a_submission_is_a_fault_of_its_own_sequence(honest, file, kind):
    with spoilt(honest / RESULT / file, kind):
        faults = validate_results(honest / "results", honest / "data").faults
    assert faults and all(fault.file.startswith("b") for fault in faults)


# ---- links


def test_a_folder_that_leads_out_is_refused_and_one_that_stays_inside_is_read(honest, tmp_path):
    data = Path(shutil.copytree(honest / "data", tmp_path / "data"))
    shutil.move(data / "sequences" / "a", tmp_path / "elsewhere")
    (data / "sequences" / "a").symlink_to(tmp_path / "elsewhere")
    shutil.move(data / "sequences" / "b" / "rgb", data / "sequences" / "b" / "colours")
    (data / "sequences" / "b" / "rgb").symlink_to("colours")
    shutil.rmtree(data / "sequences" / "c")
    findings = verify(data).findings
    assert f"{data}/sequences/c is not a folder" in findings
    assert any("'sequences/a' leads out of the folder" in line for line in findings)
    assert not any("sequences/b" in line and "leads out" in line for line in findings)


def test_a_path_that_the_user_names_may_be_a_link(honest, tmp_path):
    (tmp_path / "link").symlink_to(honest / SEQUENCE)
    assert checked.read_json(tmp_path / "link" / "sequence.json", root=tmp_path / "link")
    (tmp_path / "a.json").symlink_to(honest / SEQUENCE / "sequence.json")
    assert checked.read_json(tmp_path / "a.json", root=checked.ANYWHERE)
    assert_refused("leads out", checked.read_json, tmp_path / "a.json")


def test_a_copied_folder_takes_no_link_with_it(honest, tmp_path):
    (tmp_path / "object").mkdir()
    (tmp_path / "object" / "a.png").symlink_to(honest / SEQUENCE / "rgb" / "00000.png")
    assert_refused("leads out", checked.copy_folder, tmp_path / "object", tmp_path / "copy")
    assert not list((tmp_path / "copy").iterdir())
