"""A data folder in two: nothing of the truth is left in the half that is handed out; the other half is the truth."""

import hashlib
import json
import os
import shutil
import stat
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from refusal import assert_refused
from score_files import few_samples, score_results, submit
from synthetic_case import QUERIES, make_recording, make_truth

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import read_benchmark, write_benchmark
from freeart21.files.data_card import CARD_FILES
from freeart21.files.hidden import read_hidden
from freeart21.files.sequence import read_sequence, write_sequence
from freeart21.files.truth import write_truth
from freeart21.files.verify import verify
from leaderboard import commands
from leaderboard.pack import EPOCH_S, default_key_path, pack_public, pack_truth, read_or_create_key
from leaderboard.validate import validate_results

OBJECTS = {"mini_stapler-s5": "revolute", "cover_phone-s5": "prismatic"}
SOURCE = {
    "sensor": "hand",
    "seed": 987654321,
    "motion": "turntable",
    "category": "Stapler",
    "moving_links": ["link_lid_of_secrets"],
}


@pytest.fixture(scope="module")
def truths():
    """Name to truth, with all that a recorder says of where it came from."""
    packed = {}
    for k, (name, kind) in enumerate(OBJECTS.items()):
        packed[name] = replace(make_truth(kind, k), source={"object": name.partition("-")[0], **SOURCE})
    return packed


@pytest.fixture(scope="module")
def packed(truths, tmp_path_factory):
    """A folder with a data set, its key and both halves. In the data, whatever careless makers may have left."""
    base = tmp_path_factory.mktemp("made")
    folder = base / "secret" / "data"
    for name, truth in truths.items():
        write_sequence(folder / "sequences" / name, make_recording(truth, name), 1e-4)
        write_truth(folder / "truth" / name, truth, QUERIES)
        spoil(folder / "sequences" / name, truth)
    write_benchmark(folder, "made-up", "1", "test")
    pack_public(folder, base / "public")
    pack_truth(folder, base / "truth")
    return base


@pytest.fixture
def data(packed, tmp_path):
    return Path(shutil.copytree(packed / "secret" / "data", tmp_path / "secret" / "data"))


@pytest.fixture
def halves(packed, data, tmp_path):
    shutil.copy(default_key_path(packed / "secret" / "data"), default_key_path(data))
    return tuple(Path(shutil.copytree(packed / half, tmp_path / half)) for half in ("public", "truth"))


def spoil(sequence: Path, truth) -> None:
    header = json.loads((sequence / "sequence.json").read_text())
    header |= {"seed": SOURCE["seed"], "object": truth.source["object"], "states": truth.states.tolist()}
    header["camera"]["motion"] = SOURCE["motion"]
    (sequence / "sequence.json").write_text(json.dumps(header))
    queries = json.loads((sequence / "queries.json").read_text())
    queries["queries"][0]["T_camera_object"] = truth.Ts_camera_reference[0].tolist()
    (sequence / "queries.json").write_text(json.dumps(queries))
    (sequence / "notes.txt").write_text(truth.source["object"])
    (sequence / "rgb" / "99999.png").write_bytes(checked.encode_png(truth.query_rgb(0)))
    add_chunk(sequence / "rgb" / "00000.png", b"tEXt", f"Title\0{truth.source['object']}".encode())
    add_behind(sequence / "depth" / "00000.png", truth.states.tobytes())
    add_behind_pixels(sequence / "rgb" / "00001.png", truth.Ts_camera_moving.tobytes())
    grey = np.array([0, 200, 255], np.uint8)[truth.part_mask(0)]
    (sequence / "mask" / "00000.png").write_bytes(checked.encode_png(grey))
    os.utime(sequence / "rgb" / "00002.png", (1.6e9, 1.6e9 + truth.states[2]))
    (sequence / "depth" / "00001.png").chmod(0o750)


def add_chunk(path: Path, kind: bytes, body: bytes) -> None:
    whole = path.read_bytes()
    chunk = struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    path.write_bytes(whole[:33] + chunk + whole[33:])


def add_behind(path: Path, more: bytes) -> None:
    path.write_bytes(path.read_bytes() + more)


def add_behind_pixels(path: Path, more: bytes) -> None:
    """Append to the data that a picture's IDAT chunks hold, where a decoder has stopped to look."""
    whole, at, head, packed = path.read_bytes(), 33, b"", b""
    head = whole[:at]
    while at < len(whole):
        (length,) = struct.unpack(">I", whole[at : at + 4])
        packed += whole[at + 8 : at + 8 + length] if whole[at + 4 : at + 8] == b"IDAT" else b""
        at += 12 + length
    body = packed + more
    chunk = struct.pack(">I", len(body)) + b"IDAT" + body + struct.pack(">I", zlib.crc32(b"IDAT" + body))
    path.write_bytes(head + chunk + b"\0\0\0\0IEND\xaeB`\x82")


# ---- nothing of the truth is left


def everything(folder: Path) -> dict[str, bytes]:
    """Every name, and all bytes as they are and as they unpack."""
    found = {"names": "\n".join(str(path.relative_to(folder)) for path in folder.rglob("*")).encode()}
    for path in folder.rglob("*"):
        if path.is_file():
            whole = path.read_bytes()
            found[str(path)] = whole
            if path.suffix == ".png":
                parts, at = [], 8
                while at < len(whole):
                    (length,) = struct.unpack(">I", whole[at : at + 4]) if at + 4 <= len(whole) else (0,)
                    parts.append(whole[at + 8 : at + 8 + length] if whole[at + 4 : at + 8] == b"IDAT" else b"")
                    at += 12 + length
                found[f"{path} unpacked"] = zlib.decompressobj().decompress(b"".join(parts))
                found[f"{path} pixels"] = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_UNCHANGED).tobytes()
    return found


def secrets_of(data: Path, truths) -> dict[str, bytes]:
    """What must be nowhere: words, numbers in every spelling, hashes."""
    found = {}
    for name, truth in truths.items():
        words = (name, truth.source["object"], SOURCE["motion"], SOURCE["category"], *SOURCE["moving_links"])
        words = (*words, str(SOURCE["seed"]), hex(SOURCE["seed"])[2:], "prismatic", "revolute")
        found |= {word: word.encode() for word in words}
        found["seed"], found["seed, turned"] = struct.pack("<I", SOURCE["seed"]), struct.pack(">I", SOURCE["seed"])
        joint = truth.articulation.joint
        arrays = (truth.states, truth.Ts_camera_reference, truth.Ts_camera_moving, joint.axis, joint.pivot)
        arrays = (*arrays, np.array([truth.diagonal, truth.range_of_motion]))
        for number in np.unique(np.concatenate([array.ravel() for array in arrays])):
            if len(f"{abs(number):.12g}") >= 10:  # not 0, 1, or what else may stand anywhere
                for form in ("<d", ">d", "<f", ">f"):
                    found[f"{number} {form}"] = struct.pack(form, number)
                found[f"{number}"] = f"{abs(number):.7g}".encode()
        for path in (data / "truth" / name).rglob("*"):
            if path.is_file():
                hashed = hashlib.sha256(path.read_bytes())
                found[f"hash of {path.name}"], found[f"raw hash of {path.name}"] = (
                    hashed.hexdigest().encode(),
                    hashed.digest(),
                )
        for i in range(QUERIES):
            found[f"view {i}"] = truth.query_rgb(i)[..., ::-1].tobytes()  # as OpenCV gives pixels
    key = default_key_path(data).read_text()
    found["key"] = json.loads(key)["key"].encode()
    return found


def leaks(folder: Path, secrets: dict[str, bytes]) -> list[str]:
    places = everything(folder)
    return [
        f"{what} in {place}" for place, text in places.items() for what, secret in secrets.items() if secret in text
    ]


def test_nothing_of_the_truth_is_left_in_the_public_half(data, truths, halves):
    public, truth = halves
    secrets = secrets_of(data, truths)
    secrets["salt"] = read_hidden(truth).salt.encode()
    assert len(secrets) > 500 and leaks(public, secrets) == []
    found = leaks(data / "sequences", secrets)
    for planted in ("mini_stapler", "987654321", "turntable", "view 0", "<d"):
        assert any(planted in line for line in found), f"the search would not have found {planted}"
    assert leaks(truth, {"salt": secrets["salt"]}), "and it is where it should be"


def test_files_of_the_public_half_say_nothing_by_their_times_modes_or_kinds(halves):
    for half in halves:
        for path in (half, *half.rglob("*")):
            found = path.lstat()
            assert found.st_mtime == EPOCH_S, path
            assert stat.S_IMODE(found.st_mode) == (0o755 if path.is_dir() else 0o644) and not path.is_symlink()
    names = {path.name for path in (halves[0] / "sequences").iterdir()}
    assert len(names) == 2 and all(name.startswith("seq-") and len(name) == 16 for name in names)
    assert {path.name for path in halves[0].iterdir()} == {"benchmark.json", "sequences", *CARD_FILES}


def test_what_a_method_may_see_is_all_there(data, halves):
    public, truth = halves
    back = read_hidden(truth).names
    assert set(back.values()) == set(OBJECTS)
    for name, was in back.items():
        now, then = read_sequence(public / "sequences" / name), read_sequence(data / "sequences" / was)
        assert now.camera.K.tolist() == then.camera.K.tolist() and now.licence == then.licence
        assert np.array_equal(now.times_s, then.times_s) and len(now.queries) == len(then.queries) == QUERIES
        for a, b in zip(now.queries, then.queries, strict=True):
            assert (a.pose_of_frame, a.state_of_frame) == (b.pose_of_frame, b.state_of_frame)
            assert np.array_equal(a.T_newcam_cam, b.T_newcam_cam)
        for i in range(len(now)):
            a, b = now.frame(i), then.frame(i)
            assert np.array_equal(a.rgb, b.rgb) and np.array_equal(a.depth, b.depth) and np.array_equal(a.mask, b.mask)


PLANTS = {
    "a key": (
        lambda folder: _rewrite(folder / "sequence.json", lambda body: body | {"seed": 5}),
        "sequence.json is not as our writer writes it",
    ),
    "a chunk": (
        lambda folder: add_chunk(folder / "mask" / "00001.png", b"tIME", b"\x07\xe9\x0b\x19\x00\x00\x00"),
        "mask/00001.png has a chunk b'tIME'",
    ),
    "pixels": (
        lambda folder: add_behind_pixels(folder / "rgb" / "00001.png", b"5"),
        "rgb/00001.png has bytes behind its pixels",
    ),
    "a link": (lambda folder: (folder / "depth2").symlink_to(folder / "depth"), "depth2"),
}


def _rewrite(path: Path, change) -> None:
    path.write_text(json.dumps(change(json.loads(path.read_text())), indent=1) + "\n")


@pytest.mark.parametrize("plant", PLANTS)
def test_a_trace_that_is_planted_is_found_by_verify_whatever_the_hashes_say(plant, halves):
    public, _ = halves
    assert verify(public).findings == []
    sequence, (change, wrong) = sorted((public / "sequences").iterdir())[0], PLANTS[plant]
    change(sequence)
    listed = json.loads((public / "benchmark.json").read_text())
    for path in public.rglob("*"):
        if path.is_file() and path.name != "benchmark.json":
            listed["sha256"][str(path.relative_to(public))] = hashlib.sha256(path.read_bytes()).hexdigest()
    (public / "benchmark.json").write_text(json.dumps(listed))
    assert any(wrong in line for line in verify(public).findings)


# ---- the same bytes


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_packing_again_gives_the_same_bytes_and_replaces_only_a_pack(data, halves, tmp_path):
    public, truth = (contents(half) for half in halves)
    pack_public(data, halves[0])
    pack_truth(data, halves[1])
    assert contents(halves[0]) == public and contents(halves[1]) == truth
    (halves[0] / "mine.txt").write_text("mine")
    assert_refused(r"mine.txt in it would be lost", pack_public, data, halves[0])
    shutil.rmtree(tmp_path / "other", ignore_errors=True)
    shutil.copytree(data, tmp_path / "other")
    for pack in (pack_public, pack_truth):
        assert_refused("is no older", pack, data, tmp_path / "other")


def test_the_key_decides_names_and_salt_and_is_for_its_owner(data, halves, tmp_path):
    place = default_key_path(data)
    assert place == data.parent / "data.key" and stat.S_IMODE(place.stat().st_mode) == 0o600
    key = read_or_create_key(place)
    assert read_or_create_key(place) == key and len(key) == 32
    pack_public(data, tmp_path / "other", tmp_path / "other.key")
    names = [set(read_benchmark(folder).sequences) for folder in (halves[0], tmp_path / "other")]
    assert not names[0] & names[1]
    assert read_benchmark(halves[0]).hidden != read_benchmark(tmp_path / "other").hidden
    assert_refused(r"truth is not the truth of .*other: its digest is", read_benchmark, tmp_path / "other", halves[1])
    (tmp_path / "bad.key").write_text('{"schema": "freeart21/pack-key/1", "key": "xyz"}')
    assert_refused("'key' is not a key", pack_public, data, tmp_path / "third", tmp_path / "bad.key")


# ---- used


@pytest.fixture
def answered(truths, halves, tmp_path):
    """Results under the public names: an answer, and a sequence without one."""
    name = next(packed for packed, was in read_hidden(halves[1]).names.items() if was == "mini_stapler-s5")
    submit(tmp_path / "results" / name, truths["mini_stapler-s5"])
    return tmp_path / "results"


def test_scores_against_the_hidden_truth_are_those_of_the_whole(data, truths, halves, answered, tmp_path, monkeypatch):
    few_samples(monkeypatch)
    public, truth = halves
    submit(tmp_path / "whole" / "mini_stapler-s5", truths["mini_stapler-s5"])
    back = read_hidden(truth).names
    hidden = {back[row.sequence]: row for row in score_results(answered, public, truth=truth).rows}
    whole = {row.sequence: row for row in score_results(tmp_path / "whole", data).rows}
    assert {name: row.values for name, row in hidden.items()} == {name: row.values for name, row in whole.items()}
    assert hidden["mini_stapler-s5"].status == "ok" and hidden["cover_phone-s5"].status == "missing"
    plain = {row.truth_sha256 for row in whole.values()}
    assert not plain & {row.truth_sha256 for row in hidden.values()}, "a table's hash confirms no guess either"


def test_without_the_truth_nothing_is_scored_and_all_is_validated(halves, answered):
    public, truth = halves
    assert_refused("was packed without its truth.*--truth", score_results, answered, public)
    assert validate_results(answered, public).answers == 1
    assert_refused("is no truth of a packed set: it has no hidden.json", score_results, answered, public, truth=public)
    path = next(truth.rglob("seen.npz"))
    path.write_bytes(path.read_bytes() + b" ")
    assert_refused("is missing, or is not the file that was packed", score_results, answered, public, truth=truth)


def test_the_command_takes_one_half_at_a_time(data, tmp_path, capsys):
    for given in ({}, {"public": True, "truth": True}):
        assert_refused("name one half", commands.pack, data, tmp_path / "out", **given)
    commands.pack(data, tmp_path / "out", public=True)
    assert "data.key: the secret key of both halves" in capsys.readouterr().out
    commands.pack(data, tmp_path / "truth", truth=True)
    assert "key" not in capsys.readouterr().out
    assert_refused("would be read", commands.pack, data, data / "sequences" / "out", public=True)
    assert verify(tmp_path / "out", tmp_path / "truth").findings == []


def other_bytes(data):
    path = data / "truth" / "mini_stapler-s5" / "poses.npz"
    path.write_bytes(path.read_bytes() + b"\0")
    return rf"{path.name} has another content .* SHA-256 is [0-9a-f]{{12}}, expected [0-9a-f]{{12}}"


def missing_picture(data):
    (data / "sequences/mini_stapler-s5/rgb/00003.png").unlink()
    return r"rgb/00003\.png is missing: benchmark\.json lists it"


@pytest.mark.parametrize("half", [pack_public, pack_truth])
@pytest.mark.parametrize("spoil_one", [other_bytes, missing_picture])
def test_what_is_not_as_its_hashes_say_is_not_packed(spoil_one, half, data, tmp_path):
    words = spoil_one(data)
    with pytest.raises(FreeArtError, match=words) as caught:
        half(data, tmp_path / "out", tmp_path / "key")
    assert "\n" not in str(caught.value)
    assert {path.name for path in tmp_path.iterdir()} == {"secret"}, "not even a key is made"
