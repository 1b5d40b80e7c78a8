"""The page of teleoperation in a real browser: mouse, touch, keys and gamepad move the object, and takes hold that."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("aiohttp", reason="the extra teleop is not installed")

from browser import CHROMIUM, Browser, Navigated, browser
from teleop_case import PATIENCE_S, Served, served_aside, started

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.files.take import Take, read_take
from freeart21.files.truth import read_truth
from generator.commands import RecordOptions, record
from generator.motion.body import Body
from generator.motion.plan import Plan
from generator.motion.track import check_in_view
from generator.session import RecordSettings, catalog_entry, load_object
from generator.teleop import wire
from generator.teleop.driving import Placement
from generator.teleop.limits import Workspace
from generator.teleop.start import _object_facts

pytestmark = pytest.mark.skipif(not CHROMIUM, reason="no browser on this machine")

FOV_Y = float(np.radians(40))
CAMERA = Camera.from_fov(640, 360, FOV_Y)


class Desk:
    """Somebody at the page."""

    def __init__(self, chromium: Browser, at: Any, width: int = 1280, height: int = 720) -> None:
        self.browser, self.at = chromium, at
        self.width, self.height = width, height
        chromium.errors.clear()
        chromium.ask("Emulation.setTouchEmulationEnabled", enabled=width < 600, maxTouchPoints=5)
        chromium.open(at.url, width, height)
        self.until("teleop.link.drives && teleop.link.status && teleop.link.status.ready")
        chromium.run("void (window.sent = [], teleop.link.tap = (move) => sent.push(structuredClone(move)))")
        self.settle()

    def run(self, script: str) -> Any:
        return self.browser.run(script)

    def holds(self, true: str) -> bool:
        """Whether an expression is true in the page; not while one page gives way to the next."""
        try:
            return bool(self.run(f"Boolean({true})"))
        except Navigated:
            return False

    def until(self, true: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not self.holds(true):
            assert time.monotonic() < end, f"never: {true}; {self.run('teleop.link.status')} {self.browser.errors}"
            time.sleep(0.01)

    def settle(self) -> None:
        """Wait until the server has what the page's hand has."""
        self.until("!teleop.link._dirty")
        self.run("new Promise((done) => setTimeout(done, 120))")

    def hand(self) -> tuple[np.ndarray, float]:
        """Pose (4, 4) and state of the page's hand."""
        hand = self.run("({p: teleop.hand.position, q: teleop.hand.quaternion, s: teleop.hand.state})")
        return se3.pose_from_wxyz(hand["p"], hand["q"]), hand["s"]

    def middle(self) -> np.ndarray:
        """Where the object's centre is in the page, CSS pixels."""
        frame = self.run("teleop.desk.frame()")
        x, y, z = self.run("teleop.hand.middle()")
        scale = frame["height"] / 2 / np.tan(FOV_Y / 2)
        return np.array(
            [frame["left"] + frame["width"] / 2 + scale * x / z, frame["top"] + frame["height"] / 2 + scale * y / z]
        )

    def drag(self, way: Any, button: str = "left", modifiers: int = 0, steps: int = 8, start: Any = None) -> None:
        begin = np.array(start if start is not None else [self.width / 2, self.height / 2 - 60], float)
        mouse = {"button": button, "modifiers": modifiers}
        self.browser.ask("Input.dispatchMouseEvent", type="mousePressed", x=begin[0], y=begin[1], clickCount=1, **mouse)
        for k in range(1, steps + 1):
            x, y = begin + np.array(way, float) * k / steps
            held = {"left": 1, "right": 2, "middle": 4}[button]
            self.browser.ask("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, buttons=held, **mouse)
        self.browser.ask("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, clickCount=1, **mouse)

    def wheel(self, pixels: float, modifiers: int = 0) -> None:
        x, y = self.width / 2, self.height / 2 - 60
        self.browser.ask(
            "Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=pixels, modifiers=modifiers
        )

    def key(self, code: str, key: str, seconds: float = 0.0, modifiers: int = 0) -> None:
        more = {"code": code, "key": key, "modifiers": modifiers}
        self.browser.ask("Input.dispatchKeyEvent", type="rawKeyDown", **more)
        if seconds:
            time.sleep(seconds)
        self.browser.ask("Input.dispatchKeyEvent", type="keyUp", **more)

    def click(self, name: str) -> None:
        """Press a button where it is, by the mouse."""
        x, y = self.run(
            f"(b => [b.x + b.width / 2, b.y + b.height / 2])(document.getElementById('{name}').getBoundingClientRect())"
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.browser.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def touch(self, *paths: Any, steps: int = 8) -> None:
        """Fingers, each along a path of two points."""
        where = [np.array(path, float) for path in paths]
        points = [{"x": p[0, 0], "y": p[0, 1], "id": k} for k, p in enumerate(where)]
        self.browser.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=points)
        for step in range(1, steps + 1):
            now = [p[0] + (p[1] - p[0]) * step / steps for p in where]
            points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(now)]
            self.browser.ask("Input.dispatchTouchEvent", type="touchMove", touchPoints=points)
        self.browser.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        self.settle()

    def devices(self) -> set[str]:
        return set(self.run("[...new Set(sent.map((move) => move.device))]"))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as one:
        yield one


@pytest.fixture(scope="module")
def thing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Body, Workspace, dict[str, Any]]:
    loaded = load_object(
        catalog_entry("stapler", RecordSettings()), RecordSettings(), tmp_path_factory.mktemp("object")
    )
    body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
    room = Workspace.of(body, CAMERA)
    return body, room, _object_facts("stapler", loaded, room, FOV_Y)


@pytest.fixture
def at(chromium: Browser, tmp_path: Path, thing: tuple[Body, Workspace, dict[str, Any]]) -> Iterator[Served]:
    body, room, facts = thing
    bounds = wire.Bounds(body.lower, body.upper, room.reach)
    with served_aside(tmp_path / "take.jsonl", facts, bounds, Placement(room.T_start, room.state)) as one:
        yield one
        chromium.run("void (location.href = 'about:blank')")  # or the page would look for a server that has gone


@pytest.fixture
def desk(chromium: Browser, at: Served) -> Iterator[Desk]:
    one = Desk(chromium, at)
    yield one
    assert not chromium.errors


def turned(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The rotation vector from one pose to another, in the camera's axes."""
    return se3.log_so3(after[:3, :3] @ before[:3, :3].T)


def saved(desk: Desk, name: str = "take.jsonl") -> Take:
    """The take that the page saves when its button is pressed."""
    desk.until("!document.getElementById('save').disabled")
    desk.click("save")
    desk.until(f"(teleop.link.status.notice || '').includes('saved as {name}')")
    return read_take(desk.at.server._takes._out.with_name(name))


# --- moving -----------------------------------------------------------------------------------------------------------


def test_a_drag_turns_about_the_object_s_centre(desk: Desk) -> None:
    before, state = desk.hand()
    middle = desk.middle()
    desk.drag([120, 0], start=middle)
    after, _ = desk.hand()
    w = turned(before, after)
    assert w[1] < -0.2 and np.abs(w[[0, 2]]).max() < 0.1 * abs(w[1]), "the front follows the pointer to the right"
    assert np.abs(desk.middle() - middle).max() < 0.5 and desk.hand()[1] == state
    desk.drag([0, 120], start=middle)
    w = turned(after, desk.hand()[0])
    assert w[0] > 0.2 and np.abs(w[1:]).max() < 0.1 * w[0], "and down"
    assert desk.devices() <= {"mouse"}


@pytest.mark.parametrize("button, modifiers", [("left", 8), ("right", 0), ("middle", 0)])
def test_a_shifted_or_right_drag_moves_under_the_pointer(desk: Desk, button: str, modifiers: int) -> None:
    before, _ = desk.hand()
    middle = desk.middle()
    desk.drag([70, -40], button, modifiers, start=middle)
    after, _ = desk.hand()
    assert np.abs(desk.middle() - middle - [70, -40]).max() < 1.5
    assert np.abs(turned(before, after)).max() < 1e-9 and abs(after[2, 3] - before[2, 3]) < 1e-9


def test_the_wheel_is_the_joint_and_with_ctrl_or_alt_the_depth(desk: Desk) -> None:
    low, high = desk.run("teleop.hand.limits")
    before, _ = desk.hand()
    for _ in range(3):
        desk.wheel(-100)
    desk.until(f"Math.abs(teleop.hand.state - {low + (high - low) / 4}) < 1e-9")
    assert np.abs(turned(before, desk.hand()[0])).max() < 1e-9
    depth = desk.run("teleop.hand.middle()[2]")
    for modifiers in (2, 1):
        desk.wheel(100, modifiers)
    desk.until(f"Math.abs(teleop.hand.middle()[2] / {depth} - Math.exp(0.24)) < 1e-6")
    for _ in range(20):
        desk.wheel(-100)
    desk.until(f"teleop.hand.state === {high}")


def test_held_keys_move_and_do_not_stick(desk: Desk) -> None:
    before, _ = desk.hand()
    desk.key("ArrowRight", "ArrowRight", 0.3)
    after, _ = desk.hand()
    w = turned(before, after)
    assert w[1] < -0.05 and np.abs(w[[0, 2]]).max() < 1e-9
    middle = desk.run("teleop.hand.middle()")
    desk.key("KeyD", "d", 0.2)
    desk.key("KeyE", "e", 0.2)
    now = desk.run("teleop.hand.middle()")
    assert now[0] > middle[0] and now[2] < middle[2]
    desk.key("BracketRight", "]", 0.2)
    state = desk.run("teleop.hand.state")
    assert state > 0
    desk.browser.ask("Input.dispatchKeyEvent", type="rawKeyDown", code="KeyA", key="a")
    desk.run("window.dispatchEvent(new Event('blur'))")  # as when another window takes the keyboard
    time.sleep(0.1)
    still = desk.hand()[0]
    time.sleep(0.2)
    assert np.abs(desk.hand()[0] - still).max() == 0
    assert desk.devices() == {"keys"}


def test_a_gamepad_moves_turns_swings_and_records(desk: Desk) -> None:
    desk.run(
        "void (window.pad = {connected: true, axes: [0, 0, 0, 0], buttons: Array.from({length: 17}, () => "
        "({pressed: false, value: 0}))}, navigator.getGamepads = () => [pad])"
    )
    before, _ = desk.hand()
    desk.run("void (pad.axes = [0.05, -0.08, 0.1, 0])")  # a worn stick at rest
    time.sleep(0.15)
    assert np.abs(desk.hand()[0] - before).max() == 0
    desk.run("void (pad.axes = [0, 0, 1, 0])")
    desk.until("window.sent.length > 3")
    desk.run("void (pad.axes = [0, 0, 0, 0])")
    w = turned(before, desk.hand()[0])
    assert w[1] < 0 and np.abs(w[[0, 2]]).max() < 1e-9
    desk.run("void (pad.buttons[7] = {pressed: true, value: 1})")
    desk.until("teleop.hand.state > 0.05")
    desk.run("void (pad.buttons[7] = {pressed: false, value: 0}, pad.buttons[0] = {pressed: true, value: 1})")
    desk.until("teleop.link.status.recording")
    desk.run("void (pad.buttons[0] = {pressed: false, value: 0})")
    assert desk.devices() <= {"gamepad"}


def test_fingers_turn_move_pinch_and_twist(chromium: Browser, at: Served) -> None:
    phone = Desk(chromium, at, 390, 844)
    x, y = middle = phone.middle()
    before, _ = phone.hand()
    phone.touch([[x, y], [x + 80, y]])
    w = turned(before, phone.hand()[0])
    assert w[1] < -0.2 and np.abs(phone.middle() - middle).max() < 0.5
    depth = phone.run("teleop.hand.middle()[2]")
    phone.touch([[x - 60, y], [x - 30, y]], [[x + 60, y], [x + 30, y]])  # a pinch: half as wide, twice as far
    assert phone.run("teleop.hand.middle()[2]") == pytest.approx(2 * depth, rel=0.02)
    assert np.abs(phone.middle() - middle).max() < 2
    before, _ = phone.hand()
    phone.touch([[x - 60, y + 30], [x - 40, y + 30]], [[x + 60, y + 30], [x + 80, y + 30]])
    assert np.abs(phone.middle() - middle - [20, 0]).max() < 2 and np.abs(turned(before, phone.hand()[0])).max() < 0.02
    phone.touch([[x, y - 60], [x + 60, y]], [[x, y + 60], [x - 60, y]], steps=16)  # a quarter turn clockwise
    w = turned(before, phone.hand()[0])
    assert w[2] == pytest.approx(np.pi / 2, abs=0.1) and np.abs(w[:2]).max() < 0.05
    before, _ = phone.hand()
    middle = phone.middle()
    phone.run("document.getElementById('move').click()")
    phone.touch([[x, y], [x - 30, y + 20]])
    assert np.abs(phone.middle() - middle - [-30, 20]).max() < 1.5
    assert np.abs(turned(before, phone.hand()[0])).max() < 1e-9 and phone.devices() == {"touch"}
    assert not chromium.errors


def test_a_slider_moves_the_joint(desk: Desk) -> None:
    box = desk.run("(b => [b.x, b.y, b.width, b.height])(document.getElementById('slider').getBoundingClientRect())")
    low, high = desk.run("teleop.hand.limits")
    desk.drag([box[2] / 2 - 8, 0], start=[box[0] + 8, box[1] + box[3] / 2])
    assert desk.hand()[1] == pytest.approx(low + (high - low) / 2, abs=0.02 * (high - low))


# --- takes ------------------------------------------------------------------------------------------------------------


def test_whatever_is_done_to_it_a_take_stays_in_the_recorder_s_picture(
    desk: Desk, thing: tuple[Body, Workspace, dict[str, Any]]
) -> None:
    desk.click("record")
    desk.until("teleop.link.status.recording")
    rng = np.random.default_rng(0)
    for _ in range(12):
        desk.drag(rng.uniform(-600, 600, 2), "right" if rng.random() < 0.6 else "left", steps=4)
        desk.wheel(float(rng.choice([-300, 300])), int(rng.choice([0, 2])))
    desk.settle()
    desk.click("record")
    take = saved(desk)
    body, room, _ = thing
    plan = Plan(take.Ts, take.states, np.eye(4)[None])
    check_in_view("the take", plan, body, CAMERA, 1e-3, 60.0)
    depths = se3.transform(take.Ts, np.broadcast_to(room.centre, (len(take.times), 1, 3)))[:, 0, 2]
    assert room.nearest - 1e-9 <= depths.min() and depths.max() <= room.farthest + 1e-9


def test_undo_pause_and_going_on_leave_no_jump(desk: Desk) -> None:
    desk.key("KeyR", "r")
    desk.until("teleop.link.status.recording")
    for _ in range(4):
        desk.drag([40, 0], steps=10)
    desk.until("teleop.link.status.seconds > 2.5")
    before = desk.run("teleop.link.status.seconds")
    desk.key("KeyZ", "z", modifiers=2)
    desk.until(f"teleop.link.status.seconds < {before} - 0.5")
    desk.drag([25, 10], steps=10)
    desk.key("KeyP", "p")
    desk.until("teleop.link.status.paused")
    left, _ = desk.hand()
    desk.drag([150, 0], "right", steps=4)
    assert np.abs(desk.hand()[0] - left).max() > 1e-3
    desk.key("KeyP", "p")
    desk.until("teleop.link.status.recording")
    desk.until(f"Math.abs(teleop.hand.position[0] - ({left[0, 3]})) < 1e-6")
    desk.drag([0, 30], steps=10)
    desk.settle()
    desk.key("Enter", "Enter")
    desk.until("(teleop.link.status.notice || '').includes('saved as')")
    take = read_take(desk.at.server._takes._out)
    turns = se3.rotation_angle(np.swapaxes(take.Ts[:-1, :3, :3], 1, 2) @ take.Ts[1:, :3, :3])
    way = np.linalg.norm(np.diff(take.Ts[:, :3, 3], axis=0), axis=1)
    assert turns.max() < 0.4 and way.max() < 0.02, "no further than a drag of 40 pixels that came as one step"
    assert np.diff(take.times).max() < 1.01


def test_a_lost_connection_is_said_and_comes_back_by_itself(desk: Desk) -> None:
    desk.click("record")
    desk.until("teleop.link.status.recording")
    desk.drag([40, 0])
    desk.run("void teleop.link._socket.close()")
    desk.until("teleop.link.state === 'lost' && !document.getElementById('veil').hidden")
    assert "Connection lost" in desk.run("document.getElementById('veil-text').textContent")
    desk.until("teleop.link.drives && teleop.link.status.paused && document.getElementById('veil').hidden")
    held, _ = desk.hand()
    np.testing.assert_allclose(held, desk.at.server.driving.take.last.T, atol=1e-9)
    desk.click("record")
    desk.until("teleop.link.status.recording")
    desk.drag([40, 0])
    desk.settle()
    take = saved(desk)
    assert np.diff(take.times).max() < 1.01


def test_a_take_is_not_dropped_by_one_press(desk: Desk) -> None:
    desk.click("record")
    desk.until("teleop.link.status.samples > 5")
    desk.drag([50, 0])
    desk.click("reset")
    desk.until("document.getElementById('reset').textContent.includes('Drop take?')")
    assert desk.at.server.driving.has_take
    desk.click("reset")
    desk.until("teleop.link.status.samples === 0")
    desk.settle()
    assert np.abs(desk.hand()[0] - desk.at.server.driving.start.T).max() < 1e-9


# --- the page itself --------------------------------------------------------------------------------------------------


def test_the_token_leaves_the_address_and_nothing_comes_from_elsewhere(desk: Desk) -> None:
    assert desk.run("location.search") == "" and desk.run("location.href") == desk.at.address + "/"
    names = desk.run("performance.getEntriesByType('resource').map((entry) => entry.name)")
    assert names and all(name.startswith(desk.at.address) for name in names)
    assert desk.run("fetch('/hand.js').then((answer) => answer.status)") == 403
    desk.browser.errors.clear()  # of that fetch
    assert "default-src 'none'" in desk.run(
        "fetch(document.scripts[0].src).then((a) => a.headers.get('content-security-policy'))"
    )


def test_a_reload_goes_on_with_the_take_by_the_tab_s_own_token(desk: Desk) -> None:
    """The visible address has no token any more; another tab, or a tab of an older server, gets nothing by it."""
    desk.click("record")
    desk.drag([60, 0])
    desk.until("teleop.link.status.samples > 5")
    driving = desk.at.server.driving
    desk.run("void (window.before = true)")
    desk.browser.ask("Page.reload")
    desk.until("!window.before && window.teleop && teleop.link.drives && teleop.link.status?.paused")
    assert desk.run("location.href") == desk.at.address + "/"
    before = len(driving.take)
    assert driving.phase == "paused" and before > 5
    desk.until("teleop.link.status.ready")
    desk.browser.errors.clear()  # of the address without its token
    desk.click("record")
    desk.drag([60, 0])
    desk.until(f"teleop.link.status.samples > {before + 5}")
    assert driving.phase == "recording" and np.abs(np.diff(driving.take.times)).max() < 1.5
    desk.run("void sessionStorage.setItem('token', 'of-an-older-server')")
    desk.browser.ask("Page.reload")
    desk.until("!window.teleop && document.body && document.body.textContent.includes('the terminal printed')")
    assert desk.run("location.search") == "?token=of-an-older-server" and len(desk.browser.errors) > 0
    desk.browser.errors.clear()


@pytest.mark.parametrize("width, height", [(1440, 900), (390, 844), (844, 390), (1280, 640)])
def test_it_fits_the_screen(chromium: Browser, at: Served, width: int, height: int) -> None:
    one = Desk(chromium, at, width, height)
    fits = (
        "[...document.querySelectorAll('button, input, h1, .chips li')].filter((e) => e.offsetParent !== null && "
        "!e.closest('[hidden]')).map((e) => [e.id, e.getBoundingClientRect().toJSON()])"
    )
    for name, box in one.run(fits):
        assert box["left"] >= 0 and box["right"] <= width and box["top"] >= 0 and box["bottom"] <= height, name
    assert one.run("document.documentElement.scrollWidth") <= width
    frame = one.run("teleop.desk.frame()")
    if width < 600:
        assert frame["width"] == width and one.run("teleop.hand.aspect") < 0.7
        small = one.run(
            "[...document.querySelectorAll('.buttons > button')].filter((b) => !b.hidden).map((b) => b.offsetHeight)"
        )
        assert min(small) >= 48
    uv = one.middle()
    assert 0 < uv[0] < width and 0 < uv[1] < height and not chromium.errors


def test_the_real_thing_is_driven_seen_and_recorded(chromium: Browser, tmp_path: Path) -> None:
    with started(tmp_path / "take.jsonl", name="stapler") as real:
        chromium.errors.clear()
        desk = Desk(chromium, real)
        colours = (
            "(() => { const c = document.getElementById('picture'); const d = c.getContext('2d').getImageData(0, 0, "
            "c.width, c.height).data; let n = 0; for (let i = 0; i < d.length; i += 4) n += d[i + 2] - d[i + 1] > 40; "
            "return n / (d.length / 4); })()"
        )
        desk.until("teleop.link.status.ready")
        assert desk.run(colours) > 0.01, "the stapler's violet is seen"
        desk.click("record")
        desk.until("teleop.link.status.recording")
        for _ in range(3):
            desk.drag([60, 15], steps=10)
            desk.wheel(-100)
        desk.until("teleop.link.status.latency_ms > 0")
        desk.settle()
        desk.click("save")
        desk.until("(teleop.link.status.notice || '').includes('saved as take.jsonl')")
        sent = desk.run("sent")
        desk.run("void (location.href = 'about:blank')")
        code, output = real.stop()
        assert code == 143 and "from a move to its picture" in output and not chromium.errors
    take = read_take(tmp_path / "take.jsonl")
    small, motion = (
        RecordSettings(width=96, height=54, queries=0, shader="trivial"),
        f"teleop:{tmp_path / 'take.jsonl'}",
    )
    record(RecordOptions(("stapler",), tmp_path / "data", 6, motion=motion, settings=small))
    truth = read_truth(tmp_path / "data" / "truth" / "stapler-s0")
    begins = json.loads((tmp_path / "data" / "truth" / "stapler-s0" / "truth.json").read_text())["source"]["track"][
        "begins_s"
    ]
    times = take.times[0] + begins + np.arange(6) / 30
    k = np.searchsorted(take.times, times, side="right") - 1
    assert (np.abs(truth.states - np.interp(times, take.times, take.states)) < 1e-4).all()
    poses = se3.pose_from_wxyz([m["position"] for m in sent], [m["quaternion"] for m in sent])
    recorded = truth.Ts_camera_reference if truth.Ts_camera_reference is not None else truth.Ts_camera_moving
    for i in range(6):  # each recorded pose is one that was sent, or between two neighbours that were
        a, b = take.Ts[k[i]], take.Ts[min(k[i] + 1, len(take.Ts) - 1)]
        assert min(np.abs(poses - a).max((1, 2))) < 1e-4
        share = np.abs(recorded[i][:3, 3] - a[:3, 3]).max()
        assert share <= np.abs(b[:3, 3] - a[:3, 3]).max() + 1e-4
