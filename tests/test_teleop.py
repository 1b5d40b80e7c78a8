"""Teleoperation without a browser: what a page may say, what its moves make of a take, and who gets in."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import signal
import socket
import ssl
import subprocess
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusal import assert_refused
from teleop_case import BOUNDS, START, TOKEN, a_move, in_a_loop, page, served, started

from freeart21 import processes, se3
from freeart21.errors import FreeArtError
from freeart21.files.take import read_take, write_take
from generator.commands import teleop
from generator.settings import TeleopSettings
from generator.teleop import gate, server, stage_process, wire
from generator.teleop.driving import GAP_S, STEP_S, UNDO_S, Driving, Placement
from generator.teleop.stage import Stage
from generator.teleop.takes import Takes


def driven(driving: Driving, times: Any, epoch: int | None = None) -> None:
    """Moves at `times` (s) that turn, shift and swing steadily with time."""
    for n, t in enumerate(np.atleast_1d(times)):
        T = se3.pose(se3.exp_so3([0, 0.1 * t, 0]), [0.01 * t, 0, 1])
        epoch_now = driving.epoch if epoch is None else epoch
        driving.move(wire.Move(n, 1e3 * t, epoch_now, T, float(t) / 100, "mouse"), float(t))


def a_drive() -> Driving:
    driving = Driving(START)
    driving.record()
    driven(driving, 10 + np.arange(91) / 60)
    return driving


# --- messages ---------------------------------------------------------------------------------------------------------

ODD = st.sampled_from(
    [None, True, 1.5, 2**60, 10**1000, 1e308, -1e308, float("nan"), float("inf"), "", "x" * 3000, "\ud800", [], {},
     [1, 1], [4, 4, 4], [1, 1, 0, 0], [0] * 4, [1, 0, 0, None], "now", "rm", ["save"]]
)  # fmt: skip


def test_a_good_message_is_read_as_it_was_meant() -> None:
    data = a_move(7, 0.25) | {"epoch": 3}
    move = wire.read(json.dumps(data), BOUNDS)
    assert isinstance(move, wire.Move) and (move.n, move.epoch, move.state, move.device) == (7, 3, 0.25, "mouse")
    np.testing.assert_allclose(move.T[:3, 3], data["position"])
    np.testing.assert_allclose(se3.wxyz(move.T), data["quaternion"], atol=1e-12)
    assert wire.read('{"type":"do","what":"undo","n":4}', BOUNDS) == wire.Command("undo")
    for state, clipped in ((-0.1, 0.0), (1.5, 1.0)):
        assert wire.read(json.dumps(a_move(1, state)), BOUNDS).state == clipped


@settings(derandomize=True, deadline=None, max_examples=400)
@given(st.sampled_from([a_move(1) | {"epoch": 0}, {"type": "do", "what": "save"}, {"type": "seen", "n": 3}]), st.data())
def test_a_message_with_one_bad_field_is_none(good: dict[str, Any], data: st.DataObject) -> None:
    field = data.draw(st.sampled_from(sorted(good)))
    value = data.draw(ODD)
    text = json.dumps(good | {field: value})
    cut = data.draw(st.integers(0, 20))
    try:
        message = wire.read(text[:-cut] if cut else text, BOUNDS)
    except wire.BadMessage as error:
        assert str(error).isprintable() and len(str(error)) < 100
    else:  # what was drawn is allowed there
        assert not cut and isinstance(message, wire.Move) and np.isfinite(message.T).all() and 0 <= message.state <= 1
        assert (field, value) in [("time", 1.5), ("state", 1.5), ("position", [4, 4, 4])] and value != [4, 4, 4]


@pytest.mark.parametrize("text", ["", "[]", "7", "{}", "[" * 2000, " " * 5000, "é" * 1500, '{"type":["move"]}'])
def test_what_is_no_message_is_none(text: str) -> None:
    with pytest.raises(wire.BadMessage):
        wire.read(text, BOUNDS)


# --- driving ----------------------------------------------------------------------------------------------------------


def test_a_pause_leaves_no_gap_and_no_jump() -> None:
    driving = Driving(START)
    driven(driving, [1.0, 2.0])
    driving.record()
    driven(driving, 10 + np.arange(60) / 60)
    left = driving.place
    assert [*driving.take.times] == pytest.approx(np.arange(60) / 60) and driving.take.places[-1].is_close(left)
    assert driving.pause() and not driving.pause()
    driven(driving, 11 + np.arange(300) / 60)
    assert not driving.place.is_close(left) and len(driving.take) == 60
    epoch = driving.epoch
    assert driving.record() and driving.place.is_close(left) and driving.epoch == epoch + 1
    driven(driving, [30.0], epoch=epoch)  # sent before the page knew
    assert driving.place.is_close(left) and len(driving.take) == 60
    for time, state, devices in ((40.0, 0.0, ["mouse"]), (40.5, 0.0, ["mouse"]), (40.6, 0.01, ["mouse", "keys"])):
        driving.move(wire.Move(0, 0, driving.epoch, left.T, left.state + state, "keys"), time)
        assert list(driving.devices) == devices, "a device that moved nothing is not listed"
    assert np.diff(driving.take.times[-4:]) == pytest.approx([STEP_S, 0.5, 0.1])


def test_undo_drops_the_last_seconds_and_goes_on_from_there() -> None:
    driving = Driving(START)
    assert driving.undo() == 0
    driving.record()
    driven(driving, 10 + np.arange(301) / 60)
    whole = [*driving.take.times]
    assert driving.undo() == pytest.approx(UNDO_S, abs=2 * STEP_S) and driving.phase == "recording"
    assert driving.take.times == whole[: len(driving.take)] and driving.place.is_close(driving.take.places[-1])
    driven(driving, [20.0])
    assert np.diff(driving.take.times)[-1] == pytest.approx(STEP_S)
    while driving.undo():
        pass
    assert driving.take.times == [0.0]


def test_times_that_go_back_are_no_samples_and_long_silences_are_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    driving = Driving(START)
    driving.record()
    driven(driving, [10.0, 10.1, 10.05, 10.1, 10.2, 1e8, 1e8 + 0.1])
    assert driving.take.times == pytest.approx([0, 0.1, 0.2, 0.2 + GAP_S, 0.3 + GAP_S])
    monkeypatch.setattr("generator.teleop.driving.MAX_SAMPLES", 5)
    assert driving.is_full


# --- files ------------------------------------------------------------------------------------------------------------


def test_takes_are_numbered_and_nothing_is_replaced(tmp_path: Path) -> None:
    takes = Takes(tmp_path / "take.jsonl", "revolute")
    assert takes.next_name() == "take.jsonl" and takes.save(a_drive()).name == "take.jsonl"
    (tmp_path / "take-2.jsonl").write_text("mine")
    (tmp_path / "take-3.jsonl").symlink_to(tmp_path / "nowhere")
    assert takes.save(a_drive()).name == "take-4.jsonl"
    assert (tmp_path / "take-2.jsonl").read_text() == "mine" and not (tmp_path / "nowhere").exists()
    assert_refused("exists", Takes, tmp_path / "take.jsonl", "revolute")


def test_the_file_of_a_take_is_the_take_at_every_moment(tmp_path: Path) -> None:
    """Whatever is recorded, cut, undone, saved or discarded between two writes."""
    rng = np.random.default_rng(0)
    takes, driving, time_s = Takes(tmp_path / "take.jsonl", "revolute"), Driving(START), 10.0
    unsaved, saved = tmp_path / "take-unsaved.jsonl", 0

    def check(path: Path) -> None:
        take = read_take(path)
        np.testing.assert_allclose(take.times, driving.take.times, atol=1e-6)
        np.testing.assert_allclose(take.states, [place.state for place in driving.take.places], atol=1e-6)

    shares = {"record": 0.2, "pause": 0.1, "undo": 0.2, "move": 0.4, "reset": 0.05, "save": 0.05}
    for what in rng.choice([*shares], 300, p=[*shares.values()]):
        if what == "move":
            driven(driving, time_s + np.arange(rng.integers(1, 90)) / 60)
            time_s += rng.uniform(0.5, 3)
        elif what == "save":
            driving.pause()
            if driving.has_take:
                check(takes.save(driving))
                saved += 1
                driving.start_new_take()
        else:
            getattr(driving, what)()
        if rng.random() < 0.6:
            takes.write(driving)
            if driving.has_take:
                check(unsaved)
            assert unsaved.exists() == (driving.phase != "idle")
    takes.discard()
    assert saved > 5 and len(list(tmp_path.iterdir())) == saved


def test_a_full_disk_leaves_whole_lines_and_a_take_that_is_saved_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    takes, driving, room, write = Takes(tmp_path / "take.jsonl", "revolute"), a_drive(), [5000], os.pwrite

    def full(file: int, data: bytes, at: int) -> int:
        if at >= room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, data[: room[0] - at], at)

    monkeypatch.setattr("os.pwrite", full)
    for room[0] in (5000, 8000):
        assert_refused("No space left", takes.save, driving)
        assert (tmp_path / "take-unsaved.jsonl").read_text().endswith("\n")
    room[0] = 1 << 20
    assert len(read_take(takes.save(driving)).times) == 91


# --- the object and its picture ---------------------------------------------------------------------------------------


@in_a_loop
async def test_a_simulator_that_dies_is_started_again_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = f"struct.pack({stage_process.ANSWER.format!r}, False, 3) + b'jpg'"
    obedient = f"import struct, sys\nfor _ in sys.stdin: sys.stdout.buffer.write({answers}); sys.stdout.flush()"
    monkeypatch.setattr("freeart21.processes.command", lambda module: processes.python(obedient))
    stage, log = Stage({}, (64, 36), START), []
    drawing = asyncio.create_task(stage.run(log.append))
    for start in range(3):
        while not (stage.ready and stage.last):
            await asyncio.sleep(0.005)
        assert stage.last == b"jpg" and log == ["the simulator's process died; it is started again"] * start
        stage.process.kill()
        await stage.process.wait()
        stage.last = None
        stage.request(Placement(START.T, 0.1 * (start + 1)))
        while stage.ready:
            await asyncio.sleep(0.005)
    with pytest.raises(FreeArtError, match="died 3 times"):
        await drawing


# --- who gets in ------------------------------------------------------------------------------------------------------


@in_a_loop
async def test_only_the_token_and_the_page_s_own_origin_open_anything(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at, aiohttp.ClientSession() as session:

        async def answer(path: str, method: str = "GET", **headers: str) -> tuple[int, str]:
            async with session.request(method, at.address + path, headers=headers) as response:
                return response.status, await response.text()

        for path in server.FILES:
            for query in ("", "?token=", "?token=wrong", f"?token={TOKEN}x", "?token=é"):
                status, text = await answer(path + query)
                assert status == 403 and TOKEN not in text
            status, text = await answer(f"{path}?token={TOKEN}")
            assert status == 200 and text
        for odd in ("/..%2f..%2fpyproject.toml", "/static/hand.js", "//etc/passwd", "/%2e%2e/etc/passwd", "/hand.js/"):
            assert (await answer(f"{odd}?token={TOKEN}"))[0] in (400, 403, 404), odd
        assert (await answer(f"/?token={TOKEN}", "POST"))[0] in (404, 405)
        assert (await answer(f"/?token={TOKEN}", Host="evil.example"))[0] == 403
        good = at.address
        for token, headers in [
            ("wrong", {"Origin": good}),
            (TOKEN, {}),
            (TOKEN, {"Origin": "https://evil.example"}),
            (TOKEN, {"Origin": good.replace("http", "https")}),
            (TOKEN, {"Origin": f"http://evil.example:{at.port}", "Host": f"evil.example:{at.port}"}),
        ]:
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                await session.ws_connect(f"{good}/ws?token={token}&v=1", headers=headers)
            assert caught.value.status == 403
        assert at.server._driver is None
        async with page(f"http://localhost:{at.port}") as one:
            assert one.last("hello")["role"] == "driver"


@in_a_loop
async def test_one_drives_others_watch(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at, page(at.address) as first, page(at.address) as second:
        assert (first.last("hello")["role"], second.last("hello")["role"]) == ("driver", "watcher")
        for _ in range(3):
            await second.move(0.7)
            await second.do("record")
            await second.do("drive")
        await second.until(lambda: any("tried to drive" in line for line in at.log), "a refusal")
        assert at.server.driving.place is START and at.server.driving.phase == "idle"
        before = second.pictures
        await first.move(0.5)
        await second.status(state=0.5)
        await second.until(lambda: second.pictures > before, "a picture")
        await first.socket.close()
        await second.status(driven=False)
        await second.do("drive")
        await second.until(lambda: second.last("hello")["role"] == "driver", "the role")


# --- a session --------------------------------------------------------------------------------------------------------


@in_a_loop
async def test_a_session_saves_what_was_sent_and_goes_on_after_a_lost_connection(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at:
        async with page(at.address) as one:
            await one.stretch(np.linspace(0, 0.2, 6))
            await one.do("record")
            await one.status(recording=True)
            sent = await one.stretch(np.linspace(0.2, 0.5, 20))
            await one.say(dict(sent[3], state=0.0))  # late
            await one.until(lambda: len(at.server.driving.take) == 20, "20 samples")
        async with page(at.address) as two:
            await two.status(paused=True, driven=True)
            assert two.last("hello")["role"] == "driver" and two.last("hello")["state"] == pytest.approx(0.5)
            await two.stretch(np.linspace(0.9, 1.0, 5))  # moved while it is paused
            epoch = two.epoch
            await two.do("record")
            await two.move(0.95, epoch=epoch)  # sent before the page heard where the object was put
            await two.until(lambda: two.epoch == epoch + 1, "placed")
            assert two.last("place")["state"] == pytest.approx(0.5)
            sent += await two.stretch([0.5, 0.5])
            await two.status(samples=22)
            await two.do("save")
            await two.until(lambda: "saved as take.jsonl" in (two.last("status")["notice"] or ""), "saved")
            await two.do("save")
            await two.until(lambda: "no take" in two.last("status")["notice"], "nothing to save")
        take = read_take(tmp_path / "take.jsonl")
        np.testing.assert_allclose(take.states, [m["state"] for m in sent], atol=1e-9)
        np.testing.assert_allclose(take.Ts[:, :3, 3], [m["position"] for m in sent], atol=1e-9)
        gaps = np.diff([m["time"] for m in sent[:20]]) / 1e3
        np.testing.assert_allclose(np.diff(take.times[:20]), gaps, rtol=0.02, atol=2e-3)
        assert take.times[20] - take.times[19] == pytest.approx(STEP_S, abs=1e-5)


@in_a_loop
async def test_a_silent_driver_s_recording_is_paused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "SILENCE_S", 0.2)
    async with served(tmp_path / "take.jsonl") as at, page(at.address) as one:
        await one.do("record")
        await one.stretch([0.1, 0.2, 0.3])
        assert "silent" in (await one.status(paused=True, samples=3))["notice"]


@in_a_loop
async def test_what_cannot_be_saved_is_said_and_kept(tmp_path: Path) -> None:
    folder = tmp_path / "takes"
    folder.mkdir()
    async with served(folder / "take.jsonl") as at, page(at.address) as one:
        await one.do("record")
        await one.stretch(np.linspace(0, 1, 10))
        folder.rename(tmp_path / "elsewhere")
        folder.write_text("a file where the folder was")
        await one.do("save")
        status = await one.status(alarm=True)
        assert "not saved" in status["notice"] and status["samples"] == 10 and status["paused"]
        folder.unlink()
        await one.do("save")
        await one.status(alarm=False, samples=0)
        assert len(read_take(folder / "take.jsonl").times) == 10


@in_a_loop
async def test_floods_are_dropped_and_cost_neither_take_nor_memory(tmp_path: Path) -> None:
    async with served(tmp_path / "take.jsonl") as at:
        async with page(at.address) as one:
            await one.do("record")
            await one.stretch(np.linspace(0, 1, 10))
            for _ in range(4 * gate.MAX_BAD):
                await one.say("{" + "x" * 3000)
            await one.until(lambda: one.socket.closed, "closed")
        async with page(at.address) as two:
            await two.say("x" * (1 << 20))
            await two.until(lambda: two.socket.closed, "closed")
        async with page(at.address) as three:
            await three.status(paused=True, samples=10)
        assert any("more messages than" in line for line in at.log) and any("2048 bytes" in line for line in at.log)
        assert len(at.log) < 50 and all(len(line) < 200 for line in at.log)


# --- the command ------------------------------------------------------------------------------------------------------


def test_what_cannot_be_done_is_said_in_a_line_before_anything_starts(tmp_path: Path) -> None:
    there, out = tmp_path / "take.jsonl", tmp_path / "t.jsonl"
    there.write_text("mine")
    assert_refused("exists", teleop, "stapler", there)
    assert_refused("port", teleop, "stapler", out, settings=TeleopSettings(port=99999))
    assert_refused("64 to 1280", teleop, "stapler", out, settings=TeleopSettings(width=9))
    assert_refused("unknown object", teleop, "nothing", out)
    assert_refused("--cert FILE and --key FILE", teleop, "stapler", out, settings=TeleopSettings(host="0.0.0.0"))
    assert_refused("cannot use the certificate", teleop, "stapler", out, settings=TeleopSettings(cert=there, key=there))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert_refused("--port", teleop, "stapler", out, settings=TeleopSettings(port=taken.getsockname()[1]))
    assert there.read_text() == "mine" and [p.name for p in tmp_path.iterdir()] == ["take.jsonl"]


def test_a_take_that_nobody_saved_is_kept_whether_the_command_is_stopped_or_killed(tmp_path: Path) -> None:
    out, unsaved = tmp_path / "take.jsonl", tmp_path / "take-unsaved.jsonl"

    @in_a_loop
    async def drive(url: str) -> None:
        address, _, token = url.partition("/?token=")
        async with page(address, token) as one:
            await one.do("record")  # before there is any picture
            await one.stretch(np.linspace(0, 0.4, 30))
            await one.status(samples=30)
            await one.until(lambda: len(unsaved.read_text().splitlines()) == 31, "the file")

    with started(out) as (process, url):
        drive(url)
        process.kill()
    assert len(read_take(unsaved).times) == 30
    unsaved.rename(tmp_path / "first.jsonl")
    with started(out) as (process, url):
        drive(url)
        process.send_signal(signal.SIGINT)
        output = process.stderr.read()
    assert process.returncode == 130 and url.partition("token=")[2] not in output
    assert output.splitlines()[-1] == f"freeart21: stopped; the take that was not saved is in {unsaved}"
    assert len(read_take(unsaved).times) == 30


def test_other_machines_are_served_by_https_with_the_user_s_certificate(tmp_path: Path) -> None:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    make = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1 -subj /CN=localhost"
    names = ["-addext", "subjectAltName=DNS:localhost", "-keyout", key, "-out", cert]
    subprocess.run([*make.split(), *names], check=True, capture_output=True)
    (tmp_path / "take-unsaved.jsonl").touch()
    times = np.arange(0, 1, 1 / 60)
    Ts = se3.pose(np.eye(3), np.stack([0 * times, 0 * times, 0.5 + 0 * times], 1))
    write_take(tmp_path / "take-unsaved-2.jsonl", "mouse", "camera", "revolute", zip(times, Ts, times, strict=True))

    @in_a_loop
    async def look(url: str) -> None:
        context = ssl.create_default_context(cafile=str(cert))
        async with aiohttp.ClientSession() as session, session.get(url, ssl=context) as response:
            assert response.status == 200 and "main.js?token=" in await response.text()

    options = ("--host", "0.0.0.0", "--cert", str(cert), "--key", str(key))
    with started(tmp_path / "take.jsonl", *options) as (process, url):
        assert url.startswith(f"https://{socket.gethostname()}:")
        look(url.replace(socket.gethostname(), "localhost"))
        process.terminate()
        assert f"{tmp_path / 'take-unsaved-2.jsonl'} is a take of 1.0 s" in process.stderr.read()
    assert process.returncode == 143
