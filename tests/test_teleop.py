"""Teleoperation without a browser: what a page may say, what its moves make of a take, and who gets in."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import json
import os
import random
import signal
import socket
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("aiohttp", reason="the extra teleop is not installed")

import aiohttp
from teleop_case import BOUNDS, START, TOKEN, Served, a_move, in_a_loop, page, run, served, started

from freeart21 import child, cli, se3
from freeart21.camera import Camera
from freeart21.catalog import built_in_names
from freeart21.errors import FreeArtError
from freeart21.files.take import read_take, sample_line, write_take
from generator.commands import RecordOptions, record
from generator.motion.body import UPRIGHT, Body
from generator.scene import Scene
from generator.session import RecordSettings, catalog_entry, load_object
from generator.teleop import connections, gate, server, stage_process, wire
from generator.teleop.driving import GAP_S, STEP_S, UNDO_S, Driving, Placement
from generator.teleop.limits import FILL, Workspace
from generator.teleop.stage import Mark, Stage
from generator.teleop.takes import Takes, write_new


def driven(driving: Driving, times: Any, states: Any = None, epoch: int | None = None) -> None:
    """Moves at `times` (s) that turn and shift steadily with time, with the joint at `states`."""
    times = np.atleast_1d(times)
    states = times / 100 if states is None else np.broadcast_to(states, times.shape)
    for n, (t, q) in enumerate(zip(times, states, strict=True)):
        T = se3.pose(se3.exp_so3([0, 0.1 * t, 0]), [0.01 * t, 0, 1])
        driving.move(wire.Move(n, 1e3 * t, driving.epoch if epoch is None else epoch, T, float(q), "mouse"), float(t))


# --- messages ---------------------------------------------------------------------------------------------------------


def test_a_good_message_is_read_as_it_was_meant() -> None:
    data = a_move(7, 0.25) | {"epoch": 3}
    move = wire.read(json.dumps(data), BOUNDS)
    assert isinstance(move, wire.Move) and (move.n, move.epoch, move.state, move.device) == (7, 3, 0.25, "mouse")
    np.testing.assert_allclose(move.T[:3, 3], data["position"])
    np.testing.assert_allclose(se3.wxyz(move.T), data["quaternion"], atol=1e-12)
    assert wire.read('{"type":"ping","time":5,"latency":[1,2]}', BOUNDS) == wire.Ping(5.0, (1.0, 2.0))
    assert wire.read('{"type":"do","what":"undo","n":4}', BOUNDS) == wire.Command("undo")
    assert wire.read('{"type":"view","width":390,"height":844}', BOUNDS) == wire.ViewSize(390, 844)
    assert wire.unpack_picture(wire.pack_picture(9, 1.5, b"abc")) == (9, 1.5, b"abc")


def test_a_state_beyond_its_limits_is_brought_back() -> None:
    for given, clipped in ((-0.1, 0.0), (1.5, 1.0), (1 + 1e-15, 1.0)):
        move = wire.read(json.dumps(a_move(1, given)), BOUNDS)
        assert isinstance(move, wire.Move) and move.state == clipped


BAD: list[Any] = [
    "", "null", "[]", "7", '"move"', "{", "{}", '{"type":1}', '{"type":"shell"}', '{"type":["move"]}', "[" * 2000,
    '{"type":"ping","time":NaN}', '{"type":"ping","time":Infinity}', '{"type":"ping","time":-1}',
    '{"type":"ping","time":1' + "0" * 1000 + "}", '{"type":"ping","time":1e999}', '{"type":"ping","time":true}',
    '{"type":"do","what":"rm"}', '{"type":"do","what":["save"]}', '{"type":"view","width":0,"height":5}',
    '{"type":"view","width":1e9,"height":5}', '{"type":"seen","n":-1}', " " * 5000, "é" * 1500, "\ud800",
    a_move(1) | {"n": 1.5}, a_move(1) | {"n": True}, a_move(1) | {"n": 2**60}, a_move(1) | {"time": "now"},
    a_move(1) | {"position": [0, 0]}, a_move(1) | {"position": [0, 0, 1e9]}, a_move(1) | {"position": [4, 4, 4]},
    a_move(1) | {"position": "abc"}, a_move(1) | {"quaternion": [1, 1, 0, 0]}, a_move(1) | {"quaternion": [0] * 4},
    a_move(1) | {"quaternion": [1, 0, 0, None]}, a_move(1) | {"state": None}, a_move(1) | {"state": 1e300},
    a_move(1) | {"device": "foot"}, a_move(1) | {"device": {}}, a_move(1) | {"epoch": "x"},
]  # fmt: skip


@pytest.mark.parametrize("bad", BAD, ids=range(len(BAD)))
def test_a_bad_message_is_none(bad: Any) -> None:
    with pytest.raises(wire.BadMessage) as caught:
        wire.read(bad if isinstance(bad, str) else json.dumps(bad), BOUNDS)
    assert str(caught.value) and len(str(caught.value)) < 100


def hostile(rng: random.Random) -> str:
    """Something that somebody might send: a good message with something wrong, or noise."""
    odd = [
        None, True, -1, 2**53 + 1, 10**400, 1e308, -1e308, "", "x" * rng.randrange(4000), [], {}, [[]], "../etc/passwd",
        float("nan"), float("inf"), [1] * rng.randrange(9), {"a": {}}, "save", "\u0000", "<script>",
    ]  # fmt: skip
    message: Any = rng.choice([a_move(rng.randrange(99)), {"type": "ping", "time": 1}, {"type": "do", "what": "sav"}])
    for _ in range(rng.randrange(1, 4)):
        message[rng.choice([*message, "extra", "__proto__"])] = rng.choice(odd)
    text = json.dumps(message)
    cut = rng.random()
    if cut < 0.2:
        return text[: rng.randrange(len(text))]
    if cut < 0.3:
        return "".join(chr(rng.randrange(1, 0x3000)) for _ in range(rng.randrange(200)))
    return text


# --- driving ----------------------------------------------------------------------------------------------------------


def test_a_take_holds_what_was_moved_at_its_times() -> None:
    driving = Driving(START)
    driven(driving, [1.0, 2.0])
    driving.record()
    driven(driving, 10 + np.arange(61) / 60)
    assert [*driving.take.times] == pytest.approx(np.arange(61) / 60)
    assert [q for *_, q in driving.take.samples()] == pytest.approx((10 + np.arange(61) / 60) / 100)
    assert driving.has_take and list(driving.devices) == ["mouse"]


def test_a_pause_leaves_no_gap_and_no_jump() -> None:
    driving = Driving(START)
    driving.record()
    driven(driving, 10 + np.arange(60) / 60)
    left = driving.place
    assert driving.pause() and not driving.pause()
    driven(driving, 11 + np.arange(300) / 60)
    assert not driving.place.is_close(left) and len(driving.take) == 60
    epoch = driving.epoch
    assert driving.record() and driving.place.is_close(left) and driving.epoch == epoch + 1
    driven(driving, [30.0], epoch=epoch)  # sent before the page knew
    assert driving.place.is_close(left) and len(driving.take) == 60
    place = left
    driving.move(wire.Move(0, 0, driving.epoch, place.T, place.state, "keys"), 40.0)
    driving.move(wire.Move(0, 0, driving.epoch, place.T, place.state, "keys"), 40.5)
    assert np.diff(driving.take.times[-3:]) == pytest.approx([STEP_S, 0.5])
    assert driving.take.last.is_close(left) and list(driving.devices) == ["mouse"], "keys moved nothing"
    driving.move(wire.Move(0, 0, driving.epoch, place.T, place.state + 0.01, "keys"), 40.6)
    assert list(driving.devices) == ["mouse", "keys"]


def test_another_page_may_count_its_time_from_anywhere() -> None:
    driving = Driving(START)
    driving.record()
    driven(driving, 500 + np.arange(60) / 60)
    driving.cut()
    driven(driving, 3 + np.arange(60) / 60)
    assert [*driving.take.times] == pytest.approx(np.arange(120) / 60)


def test_undo_drops_the_last_seconds_and_goes_on_from_there() -> None:
    driving = Driving(START)
    driving.record()
    driven(driving, 10 + np.arange(301) / 60)
    whole = [*driving.take.times]
    assert driving.undo() == pytest.approx(UNDO_S, abs=2 * STEP_S) and driving.phase == "recording"
    take_times = [*driving.take.times]
    assert take_times == whole[: len(take_times)] and driving.place.is_close(driving.take.last)
    driven(driving, [20.0])
    assert np.diff(driving.take.times)[-1] == pytest.approx(STEP_S)
    while driving.undo():
        pass
    assert [*driving.take.times] == [0.0]


def test_undo_without_a_take_takes_back_what_was_moved() -> None:
    driving = Driving(START)
    driven(driving, np.arange(60) / 60 + 5)
    assert driving.undo() > 0.9 and driving.place.is_close(START)
    assert driving.undo() == 0.0


def test_undo_while_paused_takes_back_what_was_moved_since_and_then_the_take() -> None:
    driving = Driving(START)
    driving.record()
    driven(driving, 10 + np.arange(301) / 60)
    driving.pause()
    left = driving.place
    driven(driving, 20 + np.arange(30) / 60)
    assert driving.undo() > 0 and driving.place.is_close(left) and len(driving.take) == 301
    assert driving.undo() > 1.9 and len(driving.take) < 301


def test_times_that_go_back_are_no_samples_and_long_silences_are_cut() -> None:
    driving = Driving(START)
    driving.record()
    driven(driving, [10.0, 10.1, 10.05, 10.1, 10.2, 1e8, 1e8 + 0.1])
    assert [*driving.take.times] == pytest.approx([0, 0.1, 0.2, 0.2 + GAP_S, 0.3 + GAP_S])


def test_a_take_ends_where_its_file_could_not_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("generator.teleop.driving.MAX_SAMPLES", 50)
    driving = Driving(START)
    driving.record()
    driven(driving, np.arange(49) / 60)
    assert not driving.is_full
    driven(driving, [2.0])
    assert driving.is_full


# --- files ------------------------------------------------------------------------------------------------------------


def a_drive() -> Driving:
    driving = Driving(START)
    driving.record()
    driven(driving, 10 + np.arange(91) / 60)
    return driving


def test_takes_are_numbered_and_nothing_is_replaced(tmp_path: Path) -> None:
    takes = Takes(tmp_path / "take.jsonl", "revolute")
    assert takes.next_name() == "take.jsonl" and takes.save(a_drive()).name == "take.jsonl"
    (tmp_path / "take-2.jsonl").write_text("mine")
    (tmp_path / "take-3.jsonl").symlink_to(tmp_path / "nowhere")
    assert takes.next_name() == "take-4.jsonl" and takes.save(a_drive()).name == "take-4.jsonl"
    assert (tmp_path / "take-2.jsonl").read_text() == "mine" and not (tmp_path / "nowhere").exists()
    with pytest.raises(FreeArtError, match="exists"):
        Takes(tmp_path / "take.jsonl", "revolute")
    with pytest.raises(FreeArtError, match="exists"):  # as when it comes to be after one has looked
        write_new(tmp_path / "take-2.jsonl", b"theirs")
    assert (tmp_path / "take-2.jsonl").read_text() == "mine" and not list(tmp_path.glob(".*"))


def test_a_take_that_cannot_be_written_beside_is_rescued_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, elsewhere = tmp_path / "there" / "take.jsonl", tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    takes = Takes(out, "revolute")
    assert takes.rescue(a_drive()) == out.with_name("take-unsaved.jsonl")
    assert takes.rescue(a_drive()) == out.with_name("take-unsaved-2.jsonl")
    (tmp_path / "gone").write_text("a file where a folder was")
    monkeypatch.setattr(takes, "_out", tmp_path / "gone" / "take.jsonl")
    assert read_take(takes.rescue(a_drive())).times[-1] == pytest.approx(1.5)
    assert [p.name for p in elsewhere.iterdir()] == ["take-unsaved.jsonl"]


def content(driving: Driving) -> list[str]:
    """The lines of samples that the file of a take must have now."""
    return [sample_line(*one) for one in driving.take.samples()]


def test_the_file_of_a_take_is_the_take_at_every_moment(tmp_path: Path) -> None:
    """Whatever is recorded, cut, undone, saved or discarded between two writes."""
    rng = np.random.default_rng(0)
    takes, driving, time_s = Takes(tmp_path / "take.jsonl", "revolute"), Driving(START), 10.0
    unsaved, saved = tmp_path / "take-unsaved.jsonl", 0
    for _ in range(400):
        what = rng.choice(
            ["record", "pause", "undo", "move", "move", "reset", "save"], p=[0.2, 0.1, 0.2, 0.2, 0.2, 0.05, 0.05]
        )
        if what == "move":
            driven(driving, time_s + np.arange(rng.integers(1, 90)) / 60)
            time_s += rng.uniform(0.5, 3)
        elif what == "save":
            driving.pause()
            if driving.has_take:
                path, lines = takes.save(driving), content(driving)
                saved += 1
                assert path.read_text().splitlines()[1:] == lines and not unsaved.exists()
                assert len(read_take(path).times) == len(lines)
                driving.start_new_take()
        else:
            getattr(driving, what)()
        if rng.random() < 0.6:
            takes.write(driving)
            if driving.phase != "idle":
                assert unsaved.read_text().splitlines()[1:] == content(driving)
            else:
                assert not unsaved.exists()
    assert saved > 5
    takes.discard()
    assert len(list(tmp_path.iterdir())) == saved


def test_a_take_that_an_earlier_run_left_is_said_and_stays(tmp_path: Path) -> None:
    first = Takes(tmp_path / "take.jsonl", "revolute")
    driving = a_drive()
    first.write(driving)
    second = Takes(tmp_path / "take.jsonl", "revolute")
    assert second.find_unsaved_takes() == []  # it is being made
    rescued = first.rescue(driving)
    (tmp_path / "take-unsaved-old.jsonl").write_text("mine")
    (tmp_path / "take-unsaved-3.jsonl").mkdir()
    os.mkfifo(tmp_path / "take-unsaved-4.jsonl")
    assert second.find_unsaved_takes() == [(rescued, pytest.approx(1.5))]
    text = rescued.read_text()
    second.write(a_drive())
    assert rescued.read_text() == text and (tmp_path / "take-unsaved-2.jsonl").exists()


def test_what_comes_to_stand_in_the_file_s_place_is_left_alone(tmp_path: Path) -> None:
    takes, driving, unsaved = Takes(tmp_path / "take.jsonl", "revolute"), a_drive(), tmp_path / "take-unsaved.jsonl"
    takes.write(driving)
    unsaved.unlink()
    unsaved.write_text("mine")
    assert len(read_take(takes.save(driving)).times) == 91
    assert unsaved.read_text() == "mine"


def test_a_full_disk_leaves_whole_lines_and_a_take_that_is_saved_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    takes, driving, room = Takes(tmp_path / "take.jsonl", "revolute"), a_drive(), [5000]

    def full(file: int, data: bytes, at: int) -> int:
        part = data[: room[0] - at] if at < room[0] else b""
        if not part:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, part, at)

    write = os.pwrite
    monkeypatch.setattr("os.pwrite", full)
    with pytest.raises(FreeArtError, match="No space left"):
        takes.write(driving)
    (unsaved,) = tmp_path.iterdir()
    assert unsaved.read_text().endswith("\n")
    room[0] = 8000
    with pytest.raises(FreeArtError, match="No space left"):
        takes.write(driving)
    room[0] = 1 << 20
    assert len(read_take(takes.save(driving)).times) == 91


# --- where the object may be ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["swivel_usb", "stapler", "tailor_shears", "drawer_unit", "filing_cabinet"])
def test_an_object_begins_in_the_middle_and_large(name: str, tmp_path: Path) -> None:
    assert name in built_in_names()
    loaded = load_object(catalog_entry(name, RecordSettings()), RecordSettings(), tmp_path)
    body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
    camera = Camera.from_fov(640, 360, np.radians(40))
    room = Workspace.of(body, camera)
    uv = camera.project(se3.transform(room.T_start, body.points(np.array([room.state]))[0]))
    assert np.abs((uv.max(0) + uv.min(0)) / 2 - [320, 180]).max() < 3
    assert np.ptp(uv[:, 1]) / 360 == pytest.approx(FILL, abs=0.06) or np.ptp(uv[:, 0]) > 0.9 * 640
    depth = se3.transform(room.T_start, room.centre[None])[0, 2]
    assert room.nearest <= depth <= room.farthest and np.linalg.norm(room.T_start[:3, 3]) < room.reach


def test_the_live_shader_shows_the_recorder_s_colours(tmp_path: Path) -> None:
    loaded = load_object(catalog_entry("stapler", RecordSettings()), RecordSettings(), tmp_path)
    camera = Camera.from_fov(96, 54, np.radians(40))
    groups = [side.links for side in loaded.sides]
    T = se3.pose(se3.exp_so3([0.4, 0.5, -0.2]) @ UPRIGHT, [0.0, 0.0, 0.3])
    pictures = []
    for shader in ("default", stage_process.SHADER):
        scene = Scene(loaded.asset.urdf, groups, camera, 0.01, 3.0, shader)
        scene.set_camera(Camera.from_fov(192, 108, np.radians(40)))
        scene.shoot(T, {loaded.joint.name: 0.3})
        assert scene.colour_and_cover().shape == (108, 192, 4)
        scene.set_camera(camera)
        scene.shoot(T, {loaded.joint.name: 0.3})
        pictures.append(scene.colour_and_cover())
    covered = pictures[0][..., 3] > 0
    assert covered.sum() > 300 and (covered == (pictures[1][..., 3] > 0)).all()
    assert np.abs(pictures[0] - pictures[1])[covered][:, :3].max() < 0.5 / 255


def test_the_picture_s_border_has_the_page_s_colour() -> None:
    for width, height in ((640, 360), (300, 640)):
        background = stage_process.background(width, height)
        for border in (background[0], background[-1], background[:, 0], background[:, -1]):
            assert (np.abs(border.astype(int) - stage_process.EDGE) <= 1).all()
    blue, green, red = stage_process.EDGE
    style = (Path(stage_process.__file__).parent / "static" / "style.css").read_text()
    assert f"--ground: #{red:02x}{green:02x}{blue:02x};" in style


# --- who gets in ------------------------------------------------------------------------------------------------------


async def answer(address: str, path: str, **headers: str) -> tuple[int, str]:
    async with aiohttp.ClientSession() as session, session.get(address + path, headers=headers) as response:
        return response.status, await response.text()


async def raw(port: int, head: str) -> str:
    """The answer to a request exactly as it is written here."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"{head}\r\nConnection: close\r\n\r\n".encode())
    output = await reader.read(1 << 20)
    writer.close()
    return output.decode()


@in_a_loop
async def test_only_the_token_opens_the_page_and_its_files(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at:
        for path in server.FILES:
            for query in ("", "?token=", "?token=wrong", f"?token={TOKEN}x", "?token=%00", "?token=é"):
                status, text = await answer(at.address, path + query)
                assert status == 403 and TOKEN not in text
        status, text = await answer(at.address, f"/?token={TOKEN}")
        assert status == 200 and f"./main.js?token={TOKEN}" in text
        status, text = await answer(at.address, f"/main.js?token={TOKEN}")
        assert status == 200 and f'from "./hand.js?token={TOKEN}"' in text
        for odd in (
            "/../pyproject.toml", "/..%2f..%2fpyproject.toml", "/static/hand.js", "//etc/passwd", "/teleop.html",
            "/%2e%2e/%2e%2e/etc/passwd", "/hand.js/", "/hand.js%00", "/ws/..", "/.git/config", "/hand.js;x",
            "/static/../hand.js", "http://evil.example/hand.js", "/" + "a" * 3000,
        ):  # fmt: skip
            output = await raw(at.port, f"GET {odd}?token={TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:{at.port}")
            assert output.split()[1] in ("400", "403", "404"), odd
            assert len(output) < 1500 and "root:" not in output and "class Hand" not in output
        for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
            output = await raw(at.port, f"{method} /?token={TOKEN} HTTP/1.1\r\nHost: 127.0.0.1:{at.port}")
            assert output.split()[1] in ("400", "404", "405")
        output = await raw(at.port, f"GET /?token={TOKEN} HTTP/1.1\r\nHost: evil.example")
        assert output.split()[1] == "403"


@in_a_loop
async def test_a_page_of_another_origin_or_name_stays_out(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at, aiohttp.ClientSession() as session:
        good = at.address
        for token, headers in [
            ("wrong", {"Origin": good}),
            ("", {"Origin": good}),
            (TOKEN, {}),
            (TOKEN, {"Origin": "null"}),
            (TOKEN, {"Origin": "https://evil.example"}),
            (TOKEN, {"Origin": good.replace("http", "https")}),
            (TOKEN, {"Origin": f"http://127.0.0.1:{at.port + 1}"}),
            (TOKEN, {"Origin": f"http://evil.example:{at.port}", "Host": f"evil.example:{at.port}"}),
            (TOKEN, {"Origin": f"http://localhost:{at.port}"}),
        ]:
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                await session.ws_connect(f"{good}/ws?token={token}&v=1", headers=headers)
            assert caught.value.status == 403
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await session.ws_connect(f"{good}/ws?token={TOKEN}&v=9", headers={"Origin": good})
        assert at.server._driver is None and len(at.log) <= 4
        async with page(f"http://localhost:{at.port}") as one:
            assert one.last("hello")["role"] == "driver"


@in_a_loop
async def test_one_drives_others_watch(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at:
        async with page(at.address) as first, page(at.address) as second:
            assert (first.last("hello")["role"], second.last("hello")["role"]) == ("driver", "watcher")
            before = at.server.driving.place
            await second.move(0.7)
            await second.do("record")
            await second.do("drive")
            await second.say({"type": "view", "width": 10, "height": 20})
            await second.say({"type": "ping", "time": 1})
            await second.until(lambda: second.last("pong"), "pong")
            assert at.server.driving.place is before and at.server.driving.phase == "idle"
            assert at.server._stage.size == (640, 360) and second.last("hello")["role"] == "watcher"
            sent = await first.move(0.5)
            await second.until(lambda: len(second.pictures) > 1, "a picture")
            await first.until(lambda: first.pictures[-1] == (sent["n"], sent["time"]), "the picture of a move")
            assert second.pictures[-1] == (0, 0.0)
            await first.socket.close()
            await second.status(driven=False)
            await second.do("drive")
            await second.until(lambda: second.last("hello")["role"] == "driver", "the role")
            await second.move(0.25)
            await second.status(state=0.25)
        assert sum("drives" in line for line in at.log) == 2


# --- a session --------------------------------------------------------------------------------------------------------


async def a_stretch(one: Any, states: Any) -> list[dict[str, Any]]:
    """Moves at 60 a second; what was sent."""
    sent = []
    for q in states:
        sent.append(await one.move(float(q)))
        await asyncio.sleep(1 / 60)
    return sent


@in_a_loop
async def test_a_session_saves_what_was_sent(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at, page(at.address) as one:
        await a_stretch(one, np.linspace(0, 0.2, 6))
        await one.do("record")
        await one.status(recording=True)
        sent = await a_stretch(one, np.linspace(0.2, 0.9, 40))
        late = dict(sent[3], state=0.0)
        await one.say(late)
        await one.status(samples=len(sent))
        await one.do("save")
        await one.until(lambda: "saved as take.jsonl" in (one.last("status")["notice"] or ""), "saved")
        take = read_take(tmp_path / "take.jsonl")
        assert len(take.times) == len(sent)
        np.testing.assert_allclose(take.states, [m["state"] for m in sent], atol=1e-9)
        np.testing.assert_allclose(take.Ts[:, :3, 3], [m["position"] for m in sent], atol=1e-9)
        gaps = np.diff([m["time"] for m in sent]) / 1e3
        np.testing.assert_allclose(np.diff(take.times), gaps, rtol=0.02, atol=2e-3)
        assert at.server._driver.late == 1
        await one.do("save")
        await one.until(lambda: "no take" in one.last("status")["notice"], "nothing to save")


@in_a_loop
async def test_a_lost_connection_pauses_and_a_new_one_goes_on_without_gap_or_jump(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at:
        async with page(at.address) as one:
            await one.do("record")
            await a_stretch(one, np.linspace(0.2, 0.5, 20))
            await one.until(lambda: len(at.server.driving.take) == 20, "20 samples")
        async with page(at.address) as two:
            await two.status(paused=True, driven=True)
            hello = two.last("hello")
            assert hello["role"] == "driver" and hello["state"] == pytest.approx(0.5)
            np.testing.assert_allclose(hello["position"], at.server.driving.take.last.T[:3, 3])
            await a_stretch(two, np.linspace(0.9, 1.0, 5))  # moved while it is paused
            epoch = two.epoch
            await two.do("record")
            await two.move(0.95, epoch=epoch)  # sent before the page heard where the object was put
            await two.until(lambda: two.epoch == epoch + 1, "placed")
            assert two.last("place")["state"] == pytest.approx(0.5)
            two.n = 19
            await two.say(a_move(30, 0.5) | {"epoch": two.epoch, "position": hello["position"]})
            await two.say(a_move(31, 0.5) | {"epoch": two.epoch, "position": hello["position"]})
            await two.status(samples=22)
            await two.do("save")
            await two.until(lambda: (tmp_path / "take.jsonl").exists(), "the file")
        take = read_take(tmp_path / "take.jsonl")
        assert np.diff(take.times).max() < 0.2 and np.abs(np.diff(take.states)).max() < 0.1
        assert np.ptp(take.times) < 0.8


@in_a_loop
async def test_a_silent_driver_s_recording_is_paused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "SILENCE_S", 0.2)
    async with served(tmp_path / "take.jsonl") as at, page(at.address) as one:
        await one.do("record")
        await a_stretch(one, [0.1, 0.2, 0.3])
        status = await one.status(paused=True, samples=3)
        assert "silent" in status["notice"]


@in_a_loop
async def test_what_cannot_be_saved_is_said_and_kept(tmp_path: Path) -> None:
    folder = tmp_path / "takes"
    folder.mkdir()
    async with served(folder / "take.jsonl") as at, page(at.address) as one:
        await one.do("record")
        await a_stretch(one, np.linspace(0, 1, 10))
        folder.rename(tmp_path / "elsewhere")
        folder.write_text("a file where the folder was")
        await one.do("save")
        status = await one.status(alarm=True)
        assert "not saved" in status["notice"] and "press save again" in status["notice"]
        assert status["samples"] == 10 and status["paused"]
        folder.unlink()
        await one.do("save")
        await one.status(alarm=False, samples=0)
        assert len(read_take(folder / "take.jsonl").times) == 10


# --- hostile messages -------------------------------------------------------------------------------------------------


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.parametrize("doors", ["open", "as they are"])
def test_ten_thousand_hostile_messages_do_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, doors: str) -> None:
    """Open: every message is read. As they are: pages that send too much, or too much that is bad, are sent away."""
    if doors == "open":
        monkeypatch.setattr(gate, "PER_SECOND", 1e9)
        monkeypatch.setattr(gate, "BURST", 1e9)
        monkeypatch.setattr("generator.teleop.gate.Allowance._left", 1e9, raising=False)
        monkeypatch.setattr(server, "MAX_BAD", 10**9)
    rng = random.Random(1)

    async def attack(at: Served, count: int) -> int:
        pages, left = 0, count
        async with aiohttp.ClientSession() as session:
            while left > 0:
                pages += 1
                headers = {"Origin": at.address}
                async with session.ws_connect(f"{at.address}/ws?token={TOKEN}&v=1", headers=headers) as one:
                    try:
                        while left > 0 and not one.closed:
                            left -= 1
                            kind = rng.random()
                            if kind < 0.05:
                                await one.send_bytes(rng.randbytes(rng.randrange(3000)))
                            else:
                                await one.send_str(harmless(hostile(rng)))
                            if left % 50 == 0:
                                while not one.closed:  # reads what came, so that a close is seen
                                    try:
                                        await one.receive(timeout=0.001)
                                    except (TimeoutError, asyncio.TimeoutError):
                                        break
                    except (ConnectionError, aiohttp.ClientError):
                        pass
        return pages

    async def session() -> None:
        async with served(tmp_path / "take.jsonl") as at:
            before = at.server.driving.place
            await attack(at, 2000)
            gc.collect()
            memory = resident_bytes()
            pages = await attack(at, 10_000)
            gc.collect()
            assert resident_bytes() - memory < 8 << 20, "memory grew by more than 8 MB"
            driving = at.server.driving
            assert driving.place.is_close(before) and driving.phase == "idle" and not len(driving.take)
            assert pages == 1 if doors == "open" else pages >= 10
            assert len(at.log) < 400 and all(len(line) < 200 and line.isprintable() for line in at.log)
            async with page(at.address) as one:  # and it still serves
                await one.move(0.5)
                await one.status(state=0.5)
        assert not list(tmp_path.iterdir())

    run(session())


def harmless(text: str) -> str:
    """`text`, unless it is by chance a message that may do something."""
    try:
        message = wire.read(text, BOUNDS)
    except wire.BadMessage:
        return text
    return "{}" if isinstance(message, wire.Move | wire.Command | wire.ViewSize) else text


@in_a_loop
async def test_idle_connections_end_and_cost_no_take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many that say nothing, or never end their request: those give way to pages, and a take is made meanwhile."""
    monkeypatch.setattr(connections, "SPEAK_S", 0.5)
    async with served(tmp_path / "take.jsonl") as at:
        idle = []
        async with page(at.address) as one:
            await one.do("record")
            for k in range(5 * connections.MAX_CONNECTIONS):
                reader, writer = await asyncio.open_connection("127.0.0.1", at.port)
                if k % 2:
                    writer.write(b"GET / HTTP/1.1\r\nX-Slow: ")
                idle.append((reader, writer))
                if k % 50 == 0:
                    await one.move(0.5)
                    assert at.server.connections.count <= connections.MAX_PER_ADDRESS
            async with page(at.address) as two:
                assert two.last("hello")["role"] == "watcher"
            for reader, writer in idle:  # all are ended by the server
                with contextlib.suppress(ConnectionError):
                    assert await reader.read() == b""
                writer.close()
            await one.do("save")
            await one.until((tmp_path / "take.jsonl").exists, "saved")
            assert at.server.connections.count == 1
        assert any("connections of an address" in line for line in at.log) and len(at.log) < 40


@in_a_loop
async def test_who_shows_the_token_is_not_put_out_by_who_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MAX_PER_ADDRESS", 2)
    async with served(tmp_path / "take.jsonl") as at, page(at.address) as one, page(at.address) as two:
        reader, _ = await asyncio.open_connection("127.0.0.1", at.port)
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        await one.move(0.5)
        await two.status(state=0.5)


@in_a_loop
async def test_an_oversized_frame_and_a_dead_page_cost_nothing(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at:
        async with page(at.address) as one:
            await one.say(json.dumps(a_move(1, 0.9) | {"extra": "x" * 3000}))
            await one.say(json.dumps({"type": "ping", "time": 1}))
            await one.until(lambda: one.last("pong"), "pong")
            assert at.server.driving.place is START and any("2048 bytes" in line for line in at.log)
            await one.say("x" * (1 << 20))
            await one.until(lambda: one.socket.closed, "closed")
        async with page(at.address) as two:
            assert two.last("hello")["role"] == "driver"


@in_a_loop
async def test_a_flood_is_dropped(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at, page(at.address) as one:
        start = time.monotonic()
        for _ in range(900):
            await one.move(0.5)
        await one.say(json.dumps({"type": "ping", "time": 1}))  # dropped, too, or the last that is read
        most = gate.BURST + gate.PER_SECOND * (time.monotonic() - start) + 1
        await one.until(lambda: at.server._driver is None or at.server._driver.bad >= 900 - most, "bad")
        assert at.server._driver is not None and at.server._driver.bad >= 900 - most
        assert any("more messages than" in line for line in at.log)


# --- the command ------------------------------------------------------------------------------------------------------


def test_what_cannot_be_done_is_said_in_a_line_before_anything_starts(tmp_path: Path) -> None:
    there = tmp_path / "take.jsonl"
    there.write_text("mine")
    for name, out, more, message in [
        ("stapler", there, {}, "exists"),
        ("stapler", tmp_path / "t.jsonl", {"port": 99999}, "port"),
        ("stapler", tmp_path / "t.jsonl", {"port": 0, "width": 9}, "64 to 1280"),
        ("nothing", tmp_path / "t.jsonl", {}, "unknown object"),
        (str(tmp_path / "absent.urdf"), tmp_path / "t.jsonl", {}, "missing"),
        ("102990", tmp_path / "t.jsonl", {}, "--partnet-root"),
    ]:
        with pytest.raises(FreeArtError, match=message):
            cli.teleop(name, out, **more)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(FreeArtError, match="--port chooses another"):
            cli.teleop("stapler", tmp_path / "t.jsonl", port=taken.getsockname()[1])
    assert there.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == ["take.jsonl"]


def test_without_its_packages_the_command_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("generator.teleop.start.find_spec", lambda name: None)
    with pytest.raises(FreeArtError, match=r"freeart21\[teleop\]"):
        cli.teleop("stapler", tmp_path / "t.jsonl")


def test_the_command_keeps_a_take_that_nobody_saved(tmp_path: Path) -> None:
    out = tmp_path / "take.jsonl"

    async def drive(at: Any, moves: int) -> None:
        async with page(at.address, at.token) as one:
            await one.do("record")  # before there is any picture
            await a_stretch(one, np.linspace(0, 0.4, moves))
            await one.status(samples=moves)

    with started(out) as at:
        run(drive(at, 30))
        code, output = at.stop(signal.SIGINT)
    unsaved_file = tmp_path / "take-unsaved.jsonl"
    assert (
        code == 130
        and output.splitlines()[-1] == f"freeart21: stopped; the take that was not saved is in {unsaved_file}"
    )
    assert len(read_take(unsaved_file).times) == 30 and at.token not in output
    assert [p.name for p in tmp_path.iterdir()] == [unsaved_file.name]


def test_a_command_that_is_killed_has_lost_a_second_at_most(tmp_path: Path) -> None:
    """Without a word or a moment to write; and the next start says what is there."""
    out, unsaved_file = tmp_path / "take.jsonl", tmp_path / "take-unsaved.jsonl"

    async def drive(at: Any) -> None:
        async with page(at.address, at.token) as one:
            await one.do("record")
            await a_stretch(one, np.linspace(0, 0.4, 30))
            await one.status(samples=30)
            await one.until(lambda: len(unsaved_file.read_text().splitlines()) == 31, "the file")
            at.process.kill()

    with started(out) as at:
        run(drive(at))
        at.process.wait()
    assert len(read_take(unsaved_file).times) == 30
    with started(out) as at:
        assert [p.name for p in tmp_path.iterdir()] == [unsaved_file.name]
        code, output = at.stop()
    assert code == 143 and f"{unsaved_file} is a take of" in output and len(read_take(unsaved_file).times) == 30


@in_a_loop
async def test_a_simulator_that_compiles_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its process ends when drawing is cancelled, though it hears nothing: no stop signal, no end of its input."""
    deaf = "import signal\nfor n in (2, 15): signal.signal(n, signal.SIG_IGN)\nwhile True: signal.pause()"
    monkeypatch.setattr("freeart21.child.command", lambda module: child.python(deaf))
    stage = Stage({}, (64, 36), START)
    drawing = asyncio.create_task(stage.run(print))
    while stage.process is None:
        await asyncio.sleep(0.005)
    drawing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await drawing
    assert stage.process.returncode == -signal.SIGKILL


@in_a_loop
async def test_a_simulator_that_dies_is_started_again_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = "struct.pack('<Id', 3, 0.0) + b'jpg'"
    obedient = f"import struct, sys\nfor _ in sys.stdin: sys.stdout.buffer.write({answers}); sys.stdout.flush()"
    monkeypatch.setattr("freeart21.child.command", lambda module: child.python(obedient))
    stage, log = Stage({}, (64, 36), START), []
    drawing = asyncio.create_task(stage.run(log.append))
    for start in range(3):
        while not (stage.ready and stage.last):
            await asyncio.sleep(0.005)
        assert stage.last.jpeg == b"jpg" and log == ["the simulator's process died; it is started again"] * start
        stage.process.kill()
        await stage.process.wait()
        stage.last = None
        stage.request(Placement(START.T, 0.1 * (start + 1)), Mark())
        while stage.ready:
            await asyncio.sleep(0.005)
    with pytest.raises(FreeArtError, match="died 3 times"):
        await drawing


# --- replayed ---------------------------------------------------------------------------------------------------------


def test_record_takes_teleop_for_track_and_says_what_it_leaves_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    times = np.arange(0, 2, 1 / 60)
    Ts = se3.pose(np.eye(3), np.stack([0 * times, 0 * times, 0.5 + 0 * times], 1))
    write_take(tmp_path / "t.jsonl", "mouse", "camera", "revolute", zip(times, Ts, times / 4, strict=True))
    motion = f"teleop:{tmp_path / 't.jsonl'}"
    small = RecordSettings(width=96, height=64, queries=0, shader="trivial")
    record(RecordOptions(("flip_lighter",), tmp_path / "data", 4, motion=motion, settings=small))
    assert "lasts 60 frames; the 4 with most joint" in capsys.readouterr().out
    truth = json.loads((tmp_path / "data" / "truth" / "flip_lighter-s0" / "truth.json").read_text())
    assert (truth["source"]["motion"], truth["source"]["track"]["name"]) == ("track", "t.jsonl")
