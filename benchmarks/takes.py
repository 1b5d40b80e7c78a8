"""The example takes, made anew: scripts drive the real page of `freeart21 teleop`, in a headless Chromium.

    .venv/bin/python -m benchmarks.takes [--out examples/takes] [--names stapler-mouse]

A mouse, keys and two emulated controllers (iwer as a PICO 4 Ultra: `npm install --no-save iwer@2.5.0`) move an object
and its joint with least jerk, hold, grasp anew, and press the page's own buttons to record and to save. No person made
these takes, and none is claimed to have; they show what the page writes. What is there already is not replaced.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import ROOT, run_cli
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.take import read_take

sys.path.insert(0, str(ROOT / "tests"))  # whose Chromium and emulated headset these are
import headset_rig
from browser import CHROMIUM, Browser, browser

HZ = 60
PATIENCE_S = 120.0
_CONTROLLERS = """
(async () => {
  const smooth = (u) => u * u * u * (10 - 15 * u + 6 * u * u);
  const home = { p: [0.25, 1.4, -0.4], w: [0, 0, 0] };
  const base = { p: [...home.p], w: [...home.w] };
  const tremor = (t, k) => Math.sin(2 * Math.PI * (9 + k) * t + k);
  const quaternion = (w) => {
    const a = Math.hypot(...w), s = a > 1e-9 ? Math.sin(a / 2) / a : 0.5;
    return [Math.cos(a / 2), ...w.map((x) => x * s)];
  };
  const stroke = (seconds, dp = [0, 0, 0], dw = [0, 0, 0], trigger = null) => new Promise((done) => {
    const from = { p: [...base.p], w: [...base.w] };
    let start = null;
    const step = (time) => {
      start ??= time;
      const u = Math.min((time - start) / 1000 / seconds, 1), t = time / 1000;
      base.p = from.p.map((c, k) => c + smooth(u) * dp[k]);
      base.w = from.w.map((c, k) => c + smooth(u) * dw[k]);
      const p = base.p.map((c, k) => c + 2e-4 * tremor(t, k)), w = base.w.map((c, k) => c + 1.5e-3 * tremor(t, k + 3));
      rig.pose("right", p, quaternion(w));
      if (trigger) rig.press("left", "trigger", trigger[0] + smooth(u) * (trigger[1] - trigger[0]));
      if (u < 1) headset().session.requestAnimationFrame(step);
      else done();
    };
    headset().session.requestAnimationFrame(step);
  });
  const grasp = async (is) => { rig.press("right", "squeeze", is ? 1 : 0); await stroke(0.15); };
  const again = async () => {
    await grasp(false);
    await stroke(0.45, home.p.map((c, k) => c - base.p[k]), home.w.map((c, k) => c - base.w[k]));
    await grasp(true);
  };
  await stroke(0.3);
  await grasp(true);
  await stroke(0.9, [-0.01, 0.02, -0.02], [0.1, 0.7, 0.1]);
  await stroke(0.4);
  await stroke(0.5, [0.005, 0, 0], [0, 0.1, 0], [0, 0.9]);
  await again();
  await stroke(0.8, [0, -0.01, 0.01], [-0.5, 0.6, 0.2], [0.9, 0.3]);
  await stroke(0.5);
  await stroke(0.6, [-0.01, 0.01, 0], [0.3, -0.4, 0.3], [0.3, 0.8]);
  await again();
  await stroke(1.0, [0.01, 0, 0], [0.2, 0.9, -0.2], [0.8, 0]);
  await stroke(0.5);
  await grasp(false);
})()
"""
"""Movements of the right controller, which shakes as hands do, three grasps, and the left one's trigger."""


class Page:
    """The page, and a hand at its mouse and keys."""

    def __init__(self, chromium: Browser, width: int, height: int) -> None:
        self.chromium, self.middle = chromium, np.array([width / 2, height / 2 - 60])

    def until(self, what: str) -> None:
        """Wait until an expression of the server's last status `s` holds."""
        end = time.monotonic() + PATIENCE_S
        while not self.chromium.run(f"(() => {{ const s = teleop.link.status; return Boolean(s && {what}); }})()"):
            if time.monotonic() > end:
                raise FreeArtError(f"the page never came to {what}: {self.chromium.errors}")
            time.sleep(0.02)

    def mouse(self, kind: str, at: np.ndarray, **more: Any) -> None:
        self.chromium.ask("Input.dispatchMouseEvent", type=kind, x=float(at[0]), y=float(at[1]), **more)

    def click(self, button: str) -> None:
        box = f"document.getElementById('{button}').getBoundingClientRect()"
        at = np.array(self.chromium.run(f"(b => [b.x + b.width / 2, b.y + b.height / 2])({box})"))
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, at, button="left", clickCount=1)

    def drag(self, way: tuple[float, float], seconds: float, shift: bool = False) -> None:
        """One stroke of least jerk, `way` in pixels."""
        held = {"button": "left", "modifiers": 8 * shift}
        self.mouse("mousePressed", self.middle, clickCount=1, **held)
        at = self.middle
        for u in _ticks(seconds):
            at = self.middle + np.array(way) * (10 - 15 * u + 6 * u * u) * u**3
            self.mouse("mouseMoved", at, buttons=1, **held)
        self.mouse("mouseReleased", at, clickCount=1, **held)

    def wheel(self, ticks: int, seconds: float) -> None:
        for _ in range(abs(ticks)):
            self.mouse("mouseWheel", self.middle, deltaX=0, deltaY=-100.0 * float(np.sign(ticks)))
            time.sleep(seconds / abs(ticks))

    def key(self, code: str, key: str, seconds: float = 0.05) -> None:
        self.chromium.ask("Input.dispatchKeyEvent", type="rawKeyDown", code=code, key=key)
        time.sleep(seconds)
        self.chromium.ask("Input.dispatchKeyEvent", type="keyUp", code=code, key=key)


def _ticks(seconds: float) -> Iterator[float]:
    """Shares of a stroke's time, one a sixtieth of a second, as the clock has them."""
    start = time.monotonic()
    u = 0.0
    while u < 1:
        time.sleep(1 / HZ)
        u = min((time.monotonic() - start) / seconds, 1.0)
        yield u


def by_mouse(page: Page) -> None:
    """Turned in five movements, moved once, opened and closed by the wheel, with holds between."""
    page.click("record")
    page.until("s.recording")
    page.drag((190, -40), 0.9)
    time.sleep(0.4)
    page.wheel(8, 1.2)
    page.drag((-150, 90), 0.8)
    time.sleep(0.3)
    page.drag((60, 30), 0.6, shift=True)
    page.wheel(-10, 1.3)
    page.drag((120, -130), 0.9)
    time.sleep(0.5)
    page.wheel(6, 0.9)
    page.drag((-230, 20), 1.1)
    page.click("record")
    page.until("s.paused")
    page.click("save")


def by_keys(page: Page) -> None:
    """Turned, rolled and moved by keys, the joint by brackets, recorded by R and saved by Enter."""
    page.key("KeyR", "r")
    page.until("s.recording")
    for code, key, seconds in (
        ("ArrowLeft", "ArrowLeft", 0.6), ("BracketRight", "]", 1.1), ("ArrowUp", "ArrowUp", 0.5), ("Period", ".", 0.5),
        ("KeyD", "d", 0.15), ("BracketLeft", "[", 0.9), ("ArrowRight", "ArrowRight", 0.9), ("BracketRight", "]", 0.7),
        ("ArrowDown", "ArrowDown", 0.6),
    ):  # fmt: skip
        page.key(code, key, seconds)
        time.sleep(0.15)
    page.key("KeyP", "p")
    page.until("s.paused")
    page.key("Enter", "Enter")


def by_controllers(page: Page) -> None:
    """In an emulated headset: three grasps of the right hand, the left one's trigger, the A button."""
    chromium = page.chromium
    chromium.run("(async () => { window.now = await teleop.headset; window.hand = teleop.hand; })()")
    rig = headset_rig.Rig(chromium)
    for side, x in (("left", -0.25), ("right", 0.25)):
        rig.pose(side, se3.pose(np.eye(3), [x, 1.4, -0.4]))
    rig.enter()
    rig.frames(3)
    rig.press("right", "a-button", 1)
    rig.frames(2)
    rig.press("right", "a-button", 0)
    page.until("s.recording")
    chromium.run(_CONTROLLERS)
    rig.press("right", "a-button", 1)  # held, it saves


TAKES: dict[str, tuple[str, Callable[[Page], None], tuple[int, int]]] = {
    "folding_display-mouse": ("folding_display", by_mouse, (1280, 800)),
    "office_scissors-keys": ("office_scissors", by_keys, (1280, 800)),
    "stapler-controllers": ("stapler", by_controllers, (320, 180)),
}
"""Name to object, what is done to it, and the page's size."""


def main(out: Path = ROOT / "examples" / "takes", names: tuple[str, ...] = tuple(TAKES)) -> None:
    """Make the takes.

    Args:
        out: Folder for NAME.jsonl.
        names: These alone.
    """
    if not CHROMIUM:
        raise FreeArtError("no Chromium found; expected chromium, chromium-browser or google-chrome")
    for name in names:
        path = out / f"{name}.jsonl"
        if path.exists():
            raise FreeArtError(f"{path} exists; remove it first")
        thing, drive, (width, height) = TAKES[name]
        emulated = drive is by_controllers
        if emulated and not headset_rig.HAS_IWER:
            raise FreeArtError(f"{name} needs iwer: npm install --no-save iwer@2.5.0")
        small = ("--width", "320", "--height", "180") if emulated else ()
        with _teleop(thing, path, *small) as address, browser() as chromium:
            if emulated:
                headset_rig.HASTE = ""  # frames at a headset's pace
                headset_rig.emulate(chromium, "pico")
            chromium.open(address, width, height)
            page = Page(chromium, width, height)
            page.until("s.ready")
            drive(page)
            page.until("(s.notice || '').startsWith('saved')")
        take = read_take(path)
        print(f"{path}: {take.device}, {len(take.times)} samples, {np.ptp(take.times):.1f} s")


@contextmanager
def _teleop(thing: str, out: Path, *options: str) -> Iterator[str]:
    """The address of a page of its own."""
    command = [sys.executable, "-m", "freeart21", "teleop", thing, "--out", str(out), "--port", "0", *options]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    run_cli(main)
