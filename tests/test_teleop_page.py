"""The page of teleoperation in Chromium: mouse, wheel, keys, touch and an emulated headset move the object."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import CHROMIUM, PATIENCE_S, Browser, browser
from teleop_case import ROOT, served_aside, started

from freeart21 import se3
from freeart21.files.take import read_take

IWER = ROOT / "node_modules" / "iwer" / "build" / "iwer.min.js"
"""An emulated headset (MIT), brought by scripts/setup.sh dev."""
pytestmark = pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed: scripts/setup.sh dev")

_AXES = [None, None, *({"id": "thumbstick", "type": f"{axis}-axis"} for axis in "xy")]
_BUTTONS = [("trigger", "analog"), ("squeeze", "analog"), None, ("thumbstick", "binary")]


def _hand(*names: str) -> dict[str, Any]:
    buttons = [one and {"id": one[0], "type": one[1]} for one in [*_BUTTONS, *((name, "binary") for name in names)]]
    return {"gamepad": {"mapping": "xr-standard", "buttons": buttons, "axes": _AXES}, "numHapticActuators": 1}


QUEST = {
    "name": "Meta Quest 3",
    "controllerConfig": {
        "profileId": "meta-quest-touch-plus",
        "fallbackProfileIds": ["generic-trigger-squeeze-thumbstick"],
        "layout": {"left": _hand("x-button", "y-button"), "right": _hand("a-button", "b-button")},
    },
    "supportedSessionModes": ["inline", "immersive-vr"],
    "supportedFeatures": ["viewer", "local"],
    "supportedFrameRates": [72, 90],
    "isSystemKeyboardSupported": False,
    "internalNominalFrameRate": 72,
    "environmentBlendModes": {"immersive-vr": "opaque"},
    "interactionMode": "world-space",
    "userAgent": "",
}
RIG = """
window.pose = (side, p, q) => {
  const one = device.controllers[side];
  one.position.set(...p);
  one.quaternion.set(q[1], q[2], q[3], q[0]);
};
window.frames = (n) => new Promise((done) => {
  const next = () => (n-- > 0 ? now.session.session.requestAnimationFrame(next) : done());
  next();
});
"""


def until(page: Browser, true: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not page.run(f"(() => {{ const s = teleop.link.status; return Boolean(s && ({true})); }})()"):
        assert time.monotonic() < end, f"never: {true}; {page.run('teleop.link.status')} {page.errors}"
        time.sleep(0.01)


def hand(page: Browser) -> tuple[np.ndarray, float]:
    """Pose (4, 4) and state of the page's hand."""
    at = page.run("({p: teleop.hand.position, q: teleop.hand.quaternion, s: teleop.hand.state})")
    return se3.pose_from_wxyz(at["p"], at["q"]), at["s"]


def turned(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The rotation vector from one pose to another, in the camera's axes."""
    return se3.log_so3(after[:3, :3] @ before[:3, :3].T)


def drag(page: Browser, way: tuple[float, float], button: str = "left") -> None:
    """From the picture's middle along `way`, pixels."""
    x, y = page.run("(f => [f.left + f.width / 2, f.top + f.height / 2])(teleop.desk.frame())")
    mouse = {"button": button, "clickCount": 1}
    page.ask("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **mouse)
    for k in range(1, 9):
        held = {"left": 1, "right": 2}[button]
        at = {"x": x + way[0] * k / 8, "y": y + way[1] * k / 8}
        page.ask("Input.dispatchMouseEvent", type="mouseMoved", buttons=held, button=button, **at)
    page.ask("Input.dispatchMouseEvent", type="mouseReleased", **at, **mouse)


def press(page: Browser, name: str) -> None:
    page.run(f"document.getElementById('{name}').click()")


def test_the_real_thing_is_seen_driven_and_recorded_by_mouse_keys_and_touch(tmp_path: Path) -> None:
    with started(tmp_path / "take.jsonl") as (process, url), browser() as page:
        page.open(url)
        until(page, "s.ready && teleop.link.drives")
        colours = "document.getElementById('picture').getContext('2d').getImageData(0, 0, 160, 90).data"
        violet = f"[...{colours}].filter((blue, i, all) => i % 4 === 2 && blue - all[i - 1] > 40).length"
        assert page.run(violet) > 100, "the stapler is seen"
        press(page, "record")
        until(page, "s.recording")
        (before, state), (low, high) = hand(page), page.run("teleop.hand.limits")
        drag(page, (120, 0))
        after, _ = hand(page)
        assert turned(before, after)[1] < -0.2, "the front follows the pointer to the right"
        drag(page, (70, -40), "right")
        assert np.abs(turned(after, hand(page)[0])).max() < 1e-9 and hand(page)[0][0, 3] > after[0, 3]
        x, y = page.run("[innerWidth / 2, innerHeight / 3]")
        page.ask("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-300)
        until(page, f"Math.abs(teleop.hand.state - {state + (high - low) / 4}) < 1e-9")
        before, _ = hand(page)
        page.ask("Input.dispatchKeyEvent", type="rawKeyDown", code="ArrowRight", key="ArrowRight")
        page.run("new Promise((done) => setTimeout(done, 200))")
        page.ask("Input.dispatchKeyEvent", type="keyUp", code="ArrowRight", key="ArrowRight")
        w = turned(before, hand(page)[0])
        assert w[1] < -0.01 and np.abs(w[[0, 2]]).max() < 1e-9
        before, _ = hand(page)
        for kind, apart in (("touchStart", 60), ("touchMove", 45), ("touchMove", 30), ("touchEnd", 0)):
            fingers = [{"x": x + side * apart, "y": y, "id": k} for k, side in enumerate((-1, 1))] if apart else []
            page.ask("Input.dispatchTouchEvent", type=kind, touchPoints=fingers)
        assert hand(page)[0][2, 3] > 1.5 * before[2, 3], "a pinch to half the width: twice as far"
        until(page, "s.samples > 20")
        page.run("void teleop.link._socket.close()")
        until(page, "teleop.link.state === 'lost' && !document.getElementById('veil').hidden")
        until(page, "teleop.link.drives && s.paused && document.getElementById('veil').hidden")
        press(page, "save")
        until(page, "(s.notice || '').includes('saved as take.jsonl')")
        assert not page.errors
        page.run("void (location.href = 'about:blank')")
        process.terminate()
        process.wait()
    take = read_take(tmp_path / "take.jsonl")
    assert take.device == "mouse, keys, touch" and np.diff(take.times).max() < 1.01 and np.ptp(take.states) > 0


@pytest.mark.parametrize("width, height", [(1280, 800), (400, 800)])
def test_it_fits_the_screen(tmp_path: Path, width: int, height: int) -> None:
    with served_aside(tmp_path / "take.jsonl") as at, browser() as page:
        page.open(at.url, width, height)
        page.run("void (document.getElementById('help').open = true)")
        boxes = "[...document.querySelectorAll('button, input, h1, .chips li, .card')].filter((e) => e.offsetParent)"
        for box in page.run(f"{boxes}.map((e) => e.getBoundingClientRect().toJSON())"):
            assert box["left"] >= 0 and box["right"] <= width and box["top"] >= 0 and box["bottom"] <= height
        assert page.run("document.documentElement.scrollWidth") <= width and not page.errors


@pytest.mark.skipif(not IWER.is_file(), reason="iwer is not installed: scripts/setup.sh dev")
def test_a_headset_carries_swings_and_records(tmp_path: Path) -> None:
    with served_aside(tmp_path / "take.jsonl") as at, browser() as page:
        device = f"window.device = new IWER.XRDevice({json.dumps(QUEST)});"
        source = f"{IWER.read_text('utf-8')};\n{device} device.installRuntime({{forceInstall: true}});"
        page.ask("Page.addScriptToEvaluateOnNewDocument", source=source)
        page.open(at.url, 480, 270)
        until(page, "teleop.link.drives")
        page.run(f"(async () => {{ window.now = await teleop.headset; {RIG} }})()")

        def place(side: str, p: np.ndarray, w: tuple[float, float, float] = (0, 0, 0)) -> None:
            page.run(f"pose('{side}', {p.tolist()}, {se3.wxyz(se3.exp_so3(w)).tolist()})")

        def push(side: str, button: str, value: float) -> None:
            page.run(f"device.controllers.{side}.updateButtonValue('{button}', {value})")
            page.run("frames(3)")

        right = np.array([0.25, 1.4, -0.4])
        place("left", right * [-1, 1, 1])
        place("right", right)
        press(page, "headset")
        page.run("new Promise((done) => { const look = () => now.session ? done() : setTimeout(look, 5); look(); })")
        page.run("frames(3)")
        push("right", "a-button", 1)
        push("right", "a-button", 0)
        until(page, "s.recording")
        T, state = hand(page)
        push("right", "squeeze", 1)
        np.testing.assert_allclose(hand(page)[0], T, atol=1e-9, err_msg="nothing jumps")
        place("right", right + np.array([0.03, 0.02, -0.05]), (0, 0.3, 0))
        page.run("frames(3)")
        carried, _ = hand(page)
        # a person who looks along the room's -z: right, up and away are right, up and away in the picture
        np.testing.assert_allclose(carried[:3, 3] - T[:3, 3], [0.03, -0.02, 0.05], atol=1e-5)
        np.testing.assert_allclose(turned(T, carried), [0, -0.3, 0], atol=1e-5)
        push("right", "squeeze", 0)
        place("right", right)
        page.run("frames(3)")
        np.testing.assert_allclose(hand(page)[0], carried, atol=1e-9)
        page.run("device.controllers.left.updateAxes('thumbstick', 0, -1)")
        page.run("frames(8)")
        assert hand(page)[1] > state, "pushed away"
        page.run("device.controllers.left.updateAxes('thumbstick', 0, 0)")
        page.run("now.session.session.end()")
        until(page, "s.paused")
        press(page, "save")
        until(page, "(s.notice || '').includes('saved as')")
        take = read_take(tmp_path / "take.jsonl")
        assert take.device == "headset" and take.filter is not None and not page.errors
