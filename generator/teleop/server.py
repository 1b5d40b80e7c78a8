"""The server: one page drives, others watch; everything that comes in is suspected.

Pictures are never queued: a page that has not yet shown two of them gets no third, then the newest.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from importlib import resources
from typing import Any

from aiohttp import WSMsgType, web

from freeart21 import __version__, se3
from freeart21.errors import FreeArtError
from generator.teleop import wire
from generator.teleop.clock import Clock
from generator.teleop.driving import MOST_S, UNDO_S, Driving, Placement
from generator.teleop.gate import MOST_BAD, Allowance, Gate, QuietLog
from generator.teleop.limits import Room
from generator.teleop.stage import Shown, Stage, live_size
from generator.teleop.takes import Takes

FILES = {
    "/": ("teleop.html", "text/html"),
    "/style.css": ("style.css", "text/css"),
    **{
        f"/{name}.js": (f"{name}.js", "text/javascript")
        for name in ("main", "link", "hand", "desk", "keys", "pad", "panel", "headset", "clutch")
    },
}
"""All that is served: no path of a request is ever one of this machine's."""
MOST_PAGES = 16
"""Pages at once: a picture goes to each."""
STATUS_S = 0.25
"""How often pages are told how things are."""
SILENCE_S = 1.0
"""A recording is paused when its driver says nothing for so long; its page speaks 30 times a second."""
_FRAME_LIMIT = 1 << 16
"""Bytes of a message beyond which the connection is closed rather than the message dropped."""
_IN_FLIGHT = 2
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_REFUSED = (
    "<!doctype html><meta charset=utf-8><title>FreeArt-21</title><p>This page needs the address that the terminal "
    "printed, with its token. Open that again."
)


class Client:
    """One page."""

    def __init__(self, socket: web.WebSocketResponse, name: str) -> None:
        self.socket, self.name = socket, name
        self.clock, self.allowance = Clock(), Allowance()
        self.n = -1
        """Of the newest move heard."""
        self.heard = time.monotonic()
        self.sent = self.seen = 0
        """Pictures."""
        self.tells = False
        """Whether the page says which pictures it has shown."""
        self.latency: tuple[float, float] | None = None
        self.wake = asyncio.Event()
        self.late = self.bad = 0


class Server:
    """An object that pages drive and watch."""

    def __init__(
        self,
        facts: dict[str, Any],
        bounds: wire.Bounds,
        room: Room,
        stage: Stage,
        takes: Takes,
        gate: Gate,
        log: Callable[[str], None],
    ) -> None:
        """`facts` is what every page is told of the object in its `hello`."""
        self._facts, self._bounds, self._stage, self._takes, self._gate = facts, bounds, stage, takes, gate
        self._log, self._quiet = log, QuietLog(log)
        self.driving = Driving(Placement(room.T_start, min(max(0.0, bounds.lower), bounds.upper)))
        self._clients: list[Client] = []
        self._driver: Client | None = None
        self._notice, self._notice_n, self._alarm = "", 0, False
        self._budget = stage.size
        self._count = 0
        self._running: set[asyncio.Future[Any]] = set()
        stage._show = self._picture  # the stage is made before who shows its pictures

    def app(self) -> web.Application:
        """What aiohttp runs."""
        app = web.Application(client_max_size=1024)
        app.router.add_get("/ws", self._socket)
        for path in FILES:
            app.router.add_get(path, self._file)
        app.router.add_route("*", "/{anything:.*}", self._nothing)
        return app

    async def tick(self) -> None:
        """Tell the pages how things are, again and again."""
        while True:
            await asyncio.sleep(STATUS_S)
            driver = self._driver
            if self.driving.phase == "recording":
                silent = driver is not None and time.monotonic() - driver.heard > SILENCE_S
                if silent and self.driving.pause():
                    self._say(f"paused: the page was silent for {SILENCE_S:g} s")
                elif self.driving.take.seconds > MOST_S and self.driving.pause():
                    self._say(f"paused: a take lasts at most {MOST_S / 60:.0f} minutes; save it")
            await self._tell_all()

    async def close(self) -> None:
        """Send all pages away."""
        for client in [*self._clients]:
            with contextlib.suppress(Exception):
                await asyncio.wait_for(client.socket.close(code=1001, message=b"the server ends"), 1.0)

    def latency(self) -> tuple[float, float] | None:
        """What the driver's page measured last, milliseconds: median and 95th percentile."""
        return self._measured

    _measured: tuple[float, float] | None = None

    # --- requests -----------------------------------------------------------------------------------------------------

    def _refused(self, request: web.Request, socket: bool) -> web.Response | None:
        why = self._gate.refuses(
            request.query.get("token", ""), request.host or "", request.headers.get("Origin"), socket
        )
        if not why:
            return None
        self._quiet.dropped(why, _whose(request))
        return web.Response(status=403, text=_REFUSED, content_type="text/html", headers=_HEADERS)

    async def _nothing(self, request: web.Request) -> web.Response:
        return self._refused(request, False) or web.Response(status=404, text="nothing here", headers=_HEADERS)

    async def _file(self, request: web.Request) -> web.Response:
        refused = self._refused(request, False)
        if refused is not None:
            return refused
        name, kind = FILES[request.path]
        source = resources.files("generator.teleop").joinpath("static", name)
        if not source.is_file():
            return web.Response(status=404, text="nothing here", headers=_HEADERS)
        text = source.read_text("utf-8")
        # what a file names is asked for with the token, too
        for ending in (".js", ".css"):
            text = text.replace(f'{ending}"', f'{ending}?token={self._gate.token}"')
        host = request.host
        policy = (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
            f"connect-src 'self' ws://{host} wss://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        return web.Response(text=text, content_type=kind, headers={**_HEADERS, "Content-Security-Policy": policy})

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        refused = self._refused(request, True)
        if refused is not None:
            return refused
        if request.query.get("v") != wire.VERSION:
            return web.Response(status=400, text=f"expected v={wire.VERSION}", headers=_HEADERS)
        if len(self._clients) >= MOST_PAGES:
            self._quiet.dropped(f"more than {MOST_PAGES} pages", _whose(request))
            return web.Response(status=503, text="too many pages", headers=_HEADERS)
        socket = web.WebSocketResponse(max_msg_size=_FRAME_LIMIT, compress=False, heartbeat=10.0)
        await socket.prepare(request)
        self._count += 1
        client = Client(socket, f"page {self._count}")
        self._clients.append(client)
        if self._driver is None:
            self._driver = client
        self._log(f"{client.name} of {_whose(request)} {'drives' if client is self._driver else 'watches'}")
        sender = asyncio.create_task(self._send_pictures(client))
        try:
            await self._hello(client)
            client.wake.set()
            async for message in socket:
                if not self._heard(client, message):
                    break
        finally:
            sender.cancel()
            self._left(client)
        return socket

    # --- what pages say -----------------------------------------------------------------------------------------------

    def _heard(self, client: Client, message: Any) -> bool:
        """Take a message; False when its page has to go."""
        now = time.monotonic()
        if not client.allowance.takes(now):
            return self._bad(client, "more messages than a page may send")
        if message.type != WSMsgType.TEXT:
            return self._bad(client, "a message that is no text")
        try:
            said = wire.read(message.data, self._bounds)
        except wire.BadMessage as error:
            return self._bad(client, str(error))
        if isinstance(said, wire.Move):
            self._move(client, said, now)
        elif isinstance(said, wire.Ping):
            client.clock.heard(1e-3 * said.time_ms, now)
            client.latency = said.latency_ms
            if client is self._driver and said.latency_ms is not None:
                self._measured = said.latency_ms
            client.heard = now
            self._later(client, {"type": "pong", "time": said.time_ms, "server": now})
        elif isinstance(said, wire.Seen):
            client.tells, client.seen = True, min(said.count, client.sent)
            client.wake.set()
        elif isinstance(said, wire.View):
            if client is self._driver:
                self._stage.resize(live_size(*self._budget, said.width / said.height))
                self._later_all(self._size())
        elif said.what == "drive":
            self._drive(client)
        elif client is self._driver:
            self._do(said.what)
        else:
            return self._bad(client, "a wish of a page that only watches")
        return True

    def _move(self, client: Client, move: wire.Move, now: float) -> None:
        if client is not self._driver:
            self._quiet.dropped("a move of a page that only watches", client.name)
            return
        client.heard = now
        client.clock.heard(1e-3 * move.time_ms, now)
        if move.n <= client.n:
            client.late += 1
            return
        client.n = move.n
        if self.driving.move(move, client.clock.at(1e-3 * move.time_ms)):
            self._stage.want(self.driving.place, move.n, move.time_ms)

    def _bad(self, client: Client, why: str) -> bool:
        client.bad += 1
        self._quiet.dropped(why, client.name)
        if client.bad >= MOST_BAD:
            self._log(f"{client.name} is shown the door after {client.bad} bad messages")
            return False
        return True

    def _do(self, what: str) -> None:
        driving, epoch = self.driving, self.driving.epoch
        if what == "record":
            resumed = driving.phase == "paused"
            driving.record()
            self._say("recording goes on from where it was" if resumed else "recording")
        elif what == "pause":
            if driving.pause():
                self._say("paused: move freely; going on returns the object to where it is now")
        elif what == "undo":
            gone = driving.undo()
            self._say(f"the last {gone:.1f} s are undone" if gone else "back to the take's end")
        elif what == "reset":
            driving.reset()
            self._say("back at the beginning")
        elif what == "save":
            self._save()
        if driving.epoch != epoch:
            place = {"type": "place", "epoch": driving.epoch, **_numbers(driving.place)}
            self._later_all(place)
            self._stage.want(driving.place, max(self._driver.n, 0) if self._driver else 0, 0.0)

    def _save(self) -> None:
        if not self.driving.has_take:
            self._say("there is no take to save: record one")
            return
        self.driving.pause()
        try:
            path = self._takes.save(self.driving)
        except FreeArtError as error:
            self._say(f"not saved: {error}. The take is kept: press save again", alarm=True)
            return
        self._log(f"saved {path} ({self.driving.take.seconds:.1f} s, {len(self.driving.take)} samples)")
        self._say(f"saved as {path.name}: {self.driving.take.seconds:.1f} s")
        self.driving.saved()

    def _drive(self, client: Client) -> None:
        if self._driver is None:
            self._driver = client
            self._log(f"{client.name} drives")
            self._spawn(self._hello(client))

    def _left(self, client: Client) -> None:
        self._clients.remove(client)
        if client is not self._driver:
            return
        self._driver = None
        if self.driving.pause():
            self._say("paused: the driver's page has gone")
        if client.late:
            self._log(f"{client.name} sent {client.late} moves out of order; they were dropped")
        self._log(f"{client.name} has left")

    # --- what pages are told ------------------------------------------------------------------------------------------

    def _say(self, notice: str, alarm: bool = False) -> None:
        self._notice, self._alarm = notice, alarm
        self._notice_n += 1
        self._later_all(self._status())

    def _size(self) -> dict[str, Any]:
        return {"type": "size", "width": self._stage.size[0], "height": self._stage.size[1]}

    async def _hello(self, client: Client) -> None:
        driving = self.driving
        hello = {
            "type": "hello",
            "version": __version__,
            "role": "driver" if client is self._driver else "watcher",
            **self._facts,
            "limits": [self._bounds.lower, self._bounds.upper],
            "epoch": driving.epoch,
            **_numbers(driving.place),
            "start": _numbers(driving.start),
            "width": self._stage.size[0],
            "height": self._stage.size[1],
            "undo_s": UNDO_S,
            "recording": driving.phase == "recording",
        }
        await _send(client, hello)
        await _send(client, self._status())

    def _status(self) -> dict[str, Any]:
        driving, stage = self.driving, self._stage
        return {
            "type": "status",
            "ready": stage.ready and stage.last is not None,
            "recording": driving.phase == "recording",
            "paused": driving.phase == "paused",
            "seconds": round(driving.take.seconds, 2),
            "samples": len(driving.take),
            "state": driving.place.state,
            "fps": stage.fps(time.monotonic()),
            "drawing_ms": round(stage.drawing_ms(), 1),
            "latency_ms": None if self._measured is None else self._measured[0],
            "driven": self._driver is not None,
            "watchers": len(self._clients) - (self._driver is not None),
            "file": self._takes.next_name(),
            "notice": self._notice or None,
            "notice_n": self._notice_n,
            "alarm": self._alarm,
        }

    async def _tell_all(self) -> None:
        status = self._status()
        for client in [*self._clients]:
            self._later(client, status)

    def _later_all(self, message: dict[str, Any]) -> None:
        for client in self._clients:
            self._later(client, message)

    def _later(self, client: Client, message: dict[str, Any]) -> None:
        """Send without waiting; a page that takes nothing is left out, and closed by the heartbeat."""
        transport = getattr(client.socket, "_writer", None)
        transport = getattr(transport, "transport", None)
        if transport is not None and transport.get_write_buffer_size() > _FRAME_LIMIT:
            return
        self._spawn(_send(client, message))

    def _spawn(self, work: Any) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    @property
    def _tasks(self) -> set[asyncio.Future[Any]]:
        return self._running

    def _picture(self, shown: Shown) -> None:
        for client in self._clients:
            client.wake.set()

    async def _send_pictures(self, client: Client) -> None:
        last: Shown | None = None
        with contextlib.suppress(ConnectionError, RuntimeError):
            while True:
                await client.wake.wait()
                client.wake.clear()
                shown = self._stage.last
                if shown is None or shown is last or (client.tells and client.sent - client.seen >= _IN_FLIGHT):
                    continue
                last = shown
                client.sent += 1
                await client.socket.send_bytes(wire.picture(shown.n, shown.time_ms, shown.jpeg))


async def _send(client: Client, message: dict[str, Any]) -> None:
    with contextlib.suppress(ConnectionError, RuntimeError):  # it is gone
        await client.socket.send_json(message)


def _numbers(place: Placement) -> dict[str, Any]:
    return {
        "position": place.T[:3, 3].tolist(),
        "quaternion": se3.wxyz(place.T).tolist(),
        "state": place.state,
    }


def _whose(request: web.Request) -> str:
    return wire.printable(request.remote or "somebody")
