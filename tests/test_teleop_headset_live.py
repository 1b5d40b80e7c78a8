"""A headset against the real server, beyond this machine: https, the token, and takes that replay as they were made."""

from __future__ import annotations

import dataclasses
import hashlib
import http.client
import socket
import ssl
import time
from collections.abc import Iterator
from pathlib import Path

import headset_rig
import numpy as np
import pytest
from browser import Browser, browser
from headset_rig import Rig

from freeart21 import se3
from freeart21.files.take import read_take
from freeart21.files.truth import read_truth
from freeart21.one_euro import PoseFilter, headset_filter
from generator.recorder import RecordSettings, record

pytest.importorskip("aiohttp", reason="the extra teleop is not installed")
pytest.importorskip("cryptography", reason="the extra teleop is not installed")
pytest.importorskip("qrcode", reason="the extra teleop is not installed")

from teleop_case import PATIENCE_S, Started, started

needs_headset = pytest.mark.skipif(not headset_rig.HAS_IWER, reason="needs Chromium and iwer, see CONTRIBUTING.md")
HEADSET = headset_filter("revolute")


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Started]:
    """The real command for other machines, its takes in tmp_path/takes."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with started(tmp_path / "takes" / "take.jsonl", "--host", "0.0.0.0", name="stapler") as at:
        assert at.url.startswith("https://")
        yield at


def test_beyond_this_machine_it_is_https_with_its_own_names_and_the_printed_fingerprint(
    server: Started, tmp_path: Path
) -> None:
    stored = (tmp_path / "state" / "freeart21" / "teleop" / "key-and-certificate.pem").read_text()
    client = ssl.create_default_context(cadata=stored[stored.index("-----BEGIN CERTIFICATE") :])  # trusts it alone
    with (
        socket.create_connection(("127.0.0.1", server.port), 20) as raw,
        client.wrap_socket(raw, server_hostname="localhost") as secure,
    ):
        digest = hashlib.sha256(secure.getpeercert(binary_form=True) or b"").digest()
    for name in ("127.0.0.1", "localhost", socket.gethostname()):
        connection = http.client.HTTPSConnection(name, server.port, context=client, timeout=PATIENCE_S)
        connection.request("GET", f"/?token={server.token}")
        assert connection.getresponse().status == 200
    plain = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE_S)
    with pytest.raises((OSError, http.client.HTTPException)):
        plain.request("GET", f"/?token={server.token}")
        plain.getresponse()
    _, output = server.stop()
    assert ":".join(f"{byte:02X}" for byte in digest) in output


@pytest.fixture
def rig(server: Started) -> Iterator[Rig]:
    with browser() as page:
        headset_rig.emulate(page, "quest")
        # as a person does who has compared the fingerprint
        page.ask("Security.setIgnoreCertificateErrors", ignore=True)
        page.open(f"https://127.0.0.1:{server.port}/?token={server.token}", 480, 270)
        page.run(
            "(async () => { window.now = await teleop.headset; window.hand = teleop.hand; window.sent = [];"
            "teleop.link.tap = (move) => sent.push(move); })()"
        )
        made = Rig(page)
        for side, x in (("left", -0.25), ("right", 0.25)):
            made.pose(side, se3.pose(np.eye(3), [x, 1.4, -0.4]))
        made.enter()
        yield made
        assert not page.errors


def until(page: Browser, what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not page.run(f"(() => {{ const s = teleop.link.status; return {what}; }})()"):
        assert time.monotonic() < end, (what, page.run("teleop.link.status"), page.errors)
        time.sleep(0.02)


def press(rig: Rig, button: str, frames: int = 2) -> None:
    rig.press("right", button, 1)
    rig.frames(frames)
    rig.press("right", button, 0)
    rig.frames(2)


def carried_about(rig: Rig) -> None:
    """Three grasps and a sweep of the joint, while the take is recorded."""
    press(rig, "a-button")
    until(rig.page, "s.recording")
    for grasp in range(3):
        rig.pose("right", se3.pose(np.eye(3), [0.25, 1.4, -0.4]))
        rig.press("right", "squeeze", 1)
        rig.frames()
        rig.stick("left", 0, -0.7 if grasp != 1 else 0.6)
        for k in range(12):
            turn = se3.exp_so3([0.03 * k, 0.05 * k, -0.02 * k])
            rig.pose("right", se3.pose(turn, np.array([0.25, 1.4, -0.4]) + 0.002 * k * np.array([1, -0.5, 0.3])))
            rig.frames(1)
        rig.press("right", "squeeze", 0)
        rig.stick("left", 0, 0)
        rig.frames()


def wanted(moves: list[dict], times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses and states at `times` of the moves that were sent, each through the filter, then linear in time."""
    running, at, rows = PoseFilter(HEADSET), [], []
    for move in moves:
        at.append(1e-3 * (move["time"] - moves[0]["time"]))
        rows.append(running.step(at[-1], tuple(move["position"]), tuple(move["quaternion"]), move["state"]))
    Ts, states = [], []
    for t in times:
        k = int(np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2))
        u = (t - at[k]) / (at[k + 1] - at[k])
        (p, q, s), (p1, q1, s1) = rows[k], rows[k + 1]
        a, b = np.array(q), np.array(q1) * np.sign(np.dot(q, q1))
        # between neighbours a millisecond's turn is small: the chord is the arc
        Ts.append(se3.pose_from_wxyz((1 - u) * np.array(p) + u * np.array(p1), (1 - u) * a + u * b))
        states.append((1 - u) * s + u * s1)
    return np.array(Ts), np.array(states)


@needs_headset
def test_a_take_of_two_controllers_holds_what_was_sent_and_replays_it_through_the_filter(
    rig: Rig, tmp_path: Path
) -> None:
    carried_about(rig)
    rig.press("right", "a-button", 1)  # held: saved
    until(rig.page, "!s.recording && s.notice.startsWith('saved')")
    rig.press("right", "a-button", 0)
    saved = tmp_path / "takes" / "take.jsonl"
    take = read_take(saved)
    assert take.filter == HEADSET and take.device == "headset" and take.poses == "camera"
    sent, n = rig.page.run("sent"), len(take.times)
    rows = np.array([[*m["position"], *np.ravel(_turn(m)), m["state"]] for m in sent])
    stored = np.concatenate([take.Ts[:, :3, 3], take.Ts[:, :3, :3].reshape(n, 9), take.states[:, None]], 1)
    # what was sent is what is stored; before the recording the object stood still, so that the times have to tell
    fits = [k for k in range(len(rows) - n + 1) if np.abs(rows[k : k + n] - stored).max() < 1e-9]
    at = 1e-3 * np.array([move["time"] for move in sent])
    first = min(fits, key=lambda k: np.abs(np.diff(at[k : k + n]) - np.diff(take.times)).max())
    moves, page_s = sent[first : first + n], at[first : first + n]
    np.testing.assert_allclose(take.times - take.times[0], page_s - page_s[0], atol=1e-3)
    path, turns = np.ptp(take.Ts[:, :3, 3], axis=0), se3.rotation_angle(take.Ts[:, :3, :3] @ take.Ts[0, :3, :3].T)
    assert np.linalg.norm(path) > 0.03 and turns.max() > 1.2 and np.ptp(take.states) > 0.2
    assert np.linalg.norm(np.diff(take.Ts[:, :3, 3], axis=0), axis=1).max() < 0.02  # nothing jumps

    settings = RecordSettings(
        frames=20, width=96, height=54, shader="trivial", queries=1, edge=0.5, motion="track", track=saved
    )
    sequence = record("stapler", tmp_path / "data", settings)
    truth = read_truth(tmp_path / "data" / "truth" / sequence)
    replayed = [{**move, "time": 1e3 * t} for move, t in zip(moves, take.times, strict=True)]
    Ts, states = wanted(replayed, truth.source["track"]["begins_s"] + np.arange(20) / 30)
    got = truth.Ts_camera_moving if "base" in truth.source["moving_links"] else truth.Ts_camera_reference
    np.testing.assert_allclose(got, Ts, atol=1e-4)
    np.testing.assert_allclose(truth.states, states, atol=1e-4)
    assert truth.source["track"]["filter"] == {"one_euro": dataclasses.asdict(HEADSET)}


def _turn(move: dict) -> np.ndarray:
    return se3.rotation_from_wxyz(move["quaternion"])
