"""What tests of teleoperation share: a server without a simulator, a page that is no browser, and the real command."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp
import cv2
import numpy as np

from freeart21 import se3
from generator.teleop import wire
from generator.teleop.driving import Placement
from generator.teleop.gate import Gate
from generator.teleop.server import Server
from generator.teleop.takes import Takes

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 600.0
"""A guard against hanging alone: what is waited for are events, however long a busy machine takes for them."""
TOKEN = "the-token-of-a-test"
BOUNDS = wire.Bounds(0.0, 1.0, 5.0)
START = Placement(se3.pose(np.eye(3), [0.0, 0.0, 1.0]), 0.0)
FACTS = {
    "object": "thing", "joint": "hinge", "joint_type": "revolute", "fov_y": 0.7, "centre": [0.0, 0.0, 0.0],
    "depths": [0.2, 5.0], "points": [[[0.1, 0, 0], [-0.1, 0, 0]], [[0, 0.1, 0]]], "axis": [0, 0, 1], "pivot": [0, 0, 0],
}  # fmt: skip
JPEG = cv2.imencode(".jpg", np.full((360, 640, 3), 60, np.uint8))[1].tobytes()


def in_a_loop(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Let pytest run an asynchronous test."""

    @functools.wraps(test)
    def in_loop(*args: Any, **named: Any) -> None:
        asyncio.run(asyncio.wait_for(test(*args, **named), PATIENCE_S))

    return in_loop


class NoStage:
    """A stage that shows the same picture at once."""

    def __init__(self) -> None:
        self.size, self.ready, self.last, self.show = (640, 360), True, JPEG, lambda: None

    def request(self, place: Placement) -> None:
        self.last = bytes(bytearray(JPEG))  # another picture
        self.show()


@dataclass
class Served:
    """A server in this process."""

    server: Server
    port: int
    log: list[str] = field(default_factory=list)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def url(self) -> str:
        return f"{self.address}/?token={TOKEN}"


@contextlib.asynccontextmanager
async def served(out: Path) -> AsyncIterator[Served]:
    """A server of the product's own code, whose object nobody draws."""
    log: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        gate = Gate(port, token=TOKEN)
        server = Server(FACTS, BOUNDS, START, NoStage(), Takes(out, "revolute"), gate, log.append)  # type: ignore[arg-type]
        running = asyncio.create_task(server.run(listener))
        try:
            yield Served(server, port, log)
        finally:
            running.cancel()
            await server.close()


@contextlib.contextmanager
def served_aside(out: Path) -> Iterator[Served]:
    """`served`, in a thread of its own."""
    loop, ready, end = asyncio.new_event_loop(), queue.SimpleQueue[Served](), asyncio.Event()

    async def serve() -> None:
        async with served(out) as at:
            ready.put(at)
            await end.wait()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), daemon=True)
    thread.start()
    try:
        yield ready.get(timeout=PATIENCE_S)
    finally:
        loop.call_soon_threadsafe(end.set)
        thread.join(PATIENCE_S)
        loop.close()


class Page:
    """A page without a browser: its messages, and those it received."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket, self.n, self.pictures = socket, 0, 0
        self.received: list[dict[str, Any]] = []
        self._reading = asyncio.create_task(self._read())

    async def _read(self) -> None:
        async for message in self.socket:
            if message.type == aiohttp.WSMsgType.BINARY:
                self.pictures += 1
                await self.say({"type": "seen", "n": self.pictures})
            else:
                self.received.append(json.loads(message.data))

    def last(self, kind: str) -> dict[str, Any] | None:
        return next((m for m in reversed(self.received) if m["type"] == kind), None)

    async def say(self, message: Any) -> None:
        with contextlib.suppress(ConnectionError):
            await self.socket.send_str(message if isinstance(message, str) else json.dumps(message))

    async def move(self, state: float = 0.0, **changed: Any) -> dict[str, Any]:
        self.n += 1
        message = a_move(self.n, state) | {"epoch": self.epoch} | changed
        await self.say(message)
        return message

    async def stretch(self, states: Any) -> list[dict[str, Any]]:
        """Moves at 60 a second; what was sent."""
        sent = []
        for q in states:
            sent.append(await self.move(float(q)))
            await asyncio.sleep(1 / 60)
        return sent

    async def do(self, what: str) -> None:
        await self.say({"type": "do", "what": what, "n": self.n})

    @property
    def epoch(self) -> int:
        return next((m["epoch"] for m in reversed(self.received) if m["type"] in ("hello", "place")), 0)

    async def until(self, true: Any, what: str = "") -> None:
        """Wait until something is true."""
        end = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < end, f"never came: {what} {self.received[-1:]}"
            await asyncio.sleep(0.005)

    async def status(self, **wanted: Any) -> dict[str, Any]:
        """Wait for a status that says so."""
        await self.until(lambda: wanted.items() <= (self.last("status") or {}).items(), f"status {wanted}")
        return self.last("status") or {}


@contextlib.asynccontextmanager
async def page(address: str, token: str = TOKEN) -> AsyncIterator[Page]:
    """A page that has got its hello."""
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{address}/ws?token={token}&v=1", headers={"Origin": address}, max_msg_size=0) as socket,
    ):
        one = Page(socket)
        await one.until(lambda: one.last("status") is not None, "hello and status")
        yield one


def a_move(n: int, state: float = 0.0) -> dict[str, Any]:
    """A move that is as it should be."""
    return {
        "type": "move", "n": n, "time": time.monotonic() * 1e3, "position": [min(0.01 * n, 1.0), 0.0, 1.0],
        "quaternion": se3.wxyz(se3.exp_so3([0.0, 0.02 * n, 0.0])).tolist(), "state": state, "device": "mouse",
    }  # fmt: skip


@contextlib.contextmanager
def started(out: Path, *more: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`freeart21 teleop stapler --out OUT --port 0` with small pictures, and its address, until the block ends."""
    command = [sys.executable, "-m", "freeart21", "teleop", "stapler", "--out", str(out), "--port", "0"]
    process = subprocess.Popen(
        [*command, "--width", "160", "--height", "90", *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
        cwd=ROOT,
        # a shell's '&' lets the tests ignore it, and the command, which keeps to that, would never end
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    with process:
        try:
            assert process.stdout is not None and process.stderr is not None
            url = process.stdout.readline().strip()
            assert url.startswith("http"), process.stderr.read()
            yield process, url
        finally:
            process.terminate()
