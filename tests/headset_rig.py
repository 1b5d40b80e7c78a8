"""A headset without a head: iwer's emulation in a headless Chromium, and the page's files without the server."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from browser import CHROMIUM, PATIENCE_S, Browser

from freeart21 import se3

ROOT = Path(__file__).resolve().parents[1]
STATIC = ROOT / "generator" / "teleop" / "static"
IWER = Path(os.environ.get("FREEART21_IWER") or ROOT / "node_modules" / "iwer" / "build" / "iwer.min.js")
"""iwer's build (MIT), which is not ours to ship: CONTRIBUTING.md has how to get it."""
HAS_BROWSER = bool(CHROMIUM)
HAS_IWER = HAS_BROWSER and IWER.is_file()

_BUTTONS = [
    {"id": "trigger", "type": "analog", "eventTrigger": "select"},
    {"id": "squeeze", "type": "analog", "eventTrigger": "squeeze"},
    None,
    {"id": "thumbstick", "type": "binary"},
]
_AXES = [None, None, {"id": "thumbstick", "type": "x-axis"}, {"id": "thumbstick", "type": "y-axis"}]
GRIP = {  # where the hand is in the frame of iwer, (4, 4): made up, and not the same for both hands
    side: se3.pose(se3.exp_so3([-0.7, 0.1 * k, 0]), [0.004 * k, -0.015, 0.045])
    for side, k in (("left", -1), ("right", 1))
}


def _layout(side: str, names: tuple[str, str]) -> dict[str, Any]:
    buttons = [*_BUTTONS, *({"id": name, "type": "binary"} for name in names)]
    gamepad = {"mapping": "xr-standard", "buttons": buttons, "axes": _AXES}
    return {"gamepad": gamepad, "gripOffsetMatrix": GRIP[side].T.ravel().tolist(), "numHapticActuators": 1}


def device(name: str) -> str:
    """The JavaScript of a headset's configuration: profile and indices as the WebXR input profiles have them."""
    pico = name == "pico"
    profile = ["pico-4u"] if pico else ["meta-quest-touch-plus", "oculus-touch"]
    config = {
        "name": "PICO 4 Ultra" if pico else "Meta Quest 3",
        "controllerConfig": {
            "profileId": profile[0],
            "fallbackProfileIds": [*profile[1:], "generic-trigger-squeeze-thumbstick"],
            "layout": {
                "left": _layout("left", ("x-button", "y-button")),
                "right": _layout("right", ("a-button", "b-button")),
            },
        },
        "supportedSessionModes": ["inline", "immersive-vr"],
        "supportedFeatures": ["viewer", "local", *([] if pico else ["local-floor"])],
        "supportedFrameRates": [72, 90],
        "isSystemKeyboardSupported": False,
        "internalNominalFrameRate": 72,
        "environmentBlendModes": {"immersive-vr": "opaque"},
        "interactionMode": "world-space",
        "userAgent": "",
    }
    return f"window.device = new IWER.XRDevice({json.dumps(config)}); device.installRuntime({{forceInstall: true}});"


HASTE = "window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 4);"
"""Frames come as fast as they are drawn: nobody looks."""
RIG = """
window.rig = {
  frames: (n) => new Promise((done) => {
    const next = () => (n-- > 0 ? headset().session.requestAnimationFrame(next) : done());
    next();
  }),
  head(p, q) { device.position.set(...p); device.quaternion.set(q[1], q[2], q[3], q[0]); },
  pose(side, p, q) {
    const one = device.controllers[side];
    one.position.set(...p);
    one.quaternion.set(q[1], q[2], q[3], q[0]);
  },
  press: (side, button, value) => device.controllers[side].updateButtonValue(button, value),
  stick: (side, x, y) => device.controllers[side].updateAxes("thumbstick", x, y),
  seen: (side, is) => { device.controllers[side].connected = is; },
};
window.headset = () => now.session;
"""
ALONE = """
(async () => {
  const { startHeadset } = await import("/headset.js");
  const { Hand } = await import("/hand.js");
  const button = document.querySelector("#headset");
  window.hand = new Hand();
  Object.assign(hand, { limits: [0.1, 1.3], centre: [0.01, -0.02, 0.03], position: [0.02, 0.01, 0.6], state: 0.3 });
  window.said = [];
  window.sent = [];
  window.viewed = [];
  hand.onchange = (device, time) =>
    sent.push({ device, time, position: [...hand.position], quaternion: [...hand.quaternion], state: hand.state });
  window.link = {
    hello: { joint_type: "revolute" }, status: { recording: false, seconds: 0 }, drives: true, state: "open", send() {},
    do: (what) => said.push(what), shape: [300, 200], view: (...size) => viewed.push(size),
    latency: () => [21.4, 40], onpicture(f) { this.shown = f; },
  };
  window.picture = new OffscreenCanvas(640, 360);
  picture.getContext("2d").fillRect(0, 0, 640, 360);
  window.now = await startHeadset({ hand, link, picture, button });
})()
"""
"""A hand and a link of the page's kind, without a server."""


class Rig:
    """Both controllers and the head, in a page that has started."""

    def __init__(self, page: Browser) -> None:
        self.page = page
        page.run(RIG)

    def enter(self) -> None:
        """Press the button, and wait for the session's first frames."""
        self.page.run("document.querySelector('#headset').click()")
        self.page.run(
            "new Promise((done) => { const look = () => now.session ? done() : setTimeout(look, 5); look(); })"
        )
        self.frames(2)

    def frames(self, n: int = 3) -> None:
        self.page.run(f"rig.frames({n})")

    def until(self, what: str) -> None:
        """Wait for a condition in the page."""
        end = time.monotonic() + PATIENCE_S
        while not self.page.run(what):
            assert time.monotonic() < end, (what, self.page.errors)
            self.frames(1)

    def pose(self, side: str, T: np.ndarray) -> None:
        """`T` (4, 4) of a controller in the room, as iwer takes it."""
        self.page.run(f"rig.pose('{side}', {T[:3, 3].tolist()}, {se3.wxyz(T).tolist()})")

    def head(self, T: np.ndarray) -> None:
        self.page.run(f"rig.head({T[:3, 3].tolist()}, {se3.wxyz(T).tolist()})")

    def press(self, side: str, button: str, value: float) -> None:
        self.page.run(f"rig.press('{side}', '{button}', {value})")

    def stick(self, side: str, x: float, y: float) -> None:
        self.page.run(f"rig.stick('{side}', {x}, {y})")

    def set_visible(self, side: str, seen: bool) -> None:
        self.page.run(f"rig.seen('{side}', {json.dumps(seen)})")

    def object(self) -> tuple[np.ndarray, float]:
        """The hand's pose (4, 4) and state, now."""
        answer = self.page.run("({p: hand.position, q: hand.quaternion, s: hand.state})")
        return se3.pose_from_wxyz(answer["p"], answer["q"]), float(answer["s"])

    def take_messages(self) -> list[str]:
        """What was asked of the server since the last time."""
        return self.page.run("said.splice(0)")


def emulate(page: Browser, name: str) -> None:
    """Every page from now on is in a headset."""
    source = f"{HASTE}\n{IWER.read_text('utf-8')};\n{device(name)}"
    page.ask("Page.addScriptToEvaluateOnNewDocument", source=source)


class _Files(SimpleHTTPRequestHandler):
    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, directory=str(STATIC), **named)

    def do_GET(self) -> None:
        if self.path.partition("?")[0] != "/":
            super().do_GET()
            return
        page = b'<!doctype html><link rel=icon href="data:,"><button id=headset hidden>Enter headset</button>'
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(page)

    def log_message(self, *_: Any) -> None:
        pass


@contextlib.contextmanager
def served(host: str = "127.0.0.1") -> Iterator[str]:
    """The address of the page's files without a server of ours."""
    server = ThreadingHTTPServer((host, 0), _Files)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://{host}:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
