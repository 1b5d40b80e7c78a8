"""The server: one page drives, others watch; everything that comes in is suspected."""

from __future__ import annotations

import asyncio
import socket
import ssl
import time
from base64 import b64encode
from collections.abc import Callable
from hashlib import sha256
from importlib import resources
from typing import Any

from aiohttp import WSMessage, WSMsgType, web

from freeart21 import __version__, se3
from freeart21.errors import FreeArtError
from generator.teleop import wire
from generator.teleop.client import Client
from generator.teleop.connections import KEEP_S, Connections
from generator.teleop.driving import UNDO_S, Driving, Placement
from generator.teleop.gate import MOST_BAD, Gate, QuietLog
from generator.teleop.stage import Mark, Stage, live_size
from generator.teleop.takes import Takes

SCRIPTS = ("main", "link", "hand", "desk", "keys", "pad", "panel", "headset", "clutch", "room")
FILES = {
    "/": ("teleop.html", "text/html"),
    "/style.css": ("style.css", "text/css"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript") for name in SCRIPTS},
}
"""All that is served: no path of a request is ever one of this machine's."""
MAX_PAGES = 16
"""Pages at once: a picture goes to each."""
STATUS_S = 0.25
"""How often pages are told how things are."""
SILENCE_S = 1.0
"""A recording is paused when its driver says nothing for so long; its page speaks 30 times a second."""
_END_S = 1.0
"""How long connections may take to end when the server does."""
_FRAME_BYTES = 1 << 16
"""Of a message beyond which the connection is closed: shorter ones are read, and dropped beyond `wire.MAX_BYTES`."""
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_RELOAD = (
    "const token = sessionStorage.getItem('token');"
    "if (token && !location.search) location.replace('/?token=' + encodeURIComponent(token));"
)
"""Of a page that is loaded again: its token has left the visible address, but its tab has it, for this origin alone."""
_REFUSED = (
    '<!DOCTYPE html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    "<title>FreeArt-21</title><p>This page opens by the address that the terminal printed, with its token. Open that "
    f"address again.</p><script>{_RELOAD}</script></html>"
)
_REFUSED_POLICY = (
    f"default-src 'none'; script-src 'sha256-{b64encode(sha256(_RELOAD.encode()).digest()).decode()}'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Server:
    """An object that pages drive and watch."""

    def __init__(
        self,
        facts: dict[str, Any],
        bounds: wire.Bounds,
        start: Placement,
        stage: Stage,
        takes: Takes,
        gate: Gate,
        log: Callable[[str], None],
    ) -> None:
        """`facts` is what every page is told of the object in its `hello`."""
        self._facts, self._bounds, self._stage, self._takes, self._gate = facts, bounds, stage, takes, gate
        self._log, self._quiet = log, QuietLog(log)
        self._runner = web.AppRunner(
            self._app(), access_log=None, handle_signals=False, shutdown_timeout=_END_S, keepalive_timeout=KEEP_S
        )
        self.connections = Connections(self._new_protocol, self._quiet)
        self.driving = Driving(start)
        self.latency_ms: tuple[float, float] | None = None
        """What a driver's page measured last: median and 95th percentile."""
        self._clients: list[Client] = []
        self._driver: Client | None = None
        self._count = 0
        self._saving: asyncio.Task[None] | None = None
        self._notice, self._notices, self._alarm = "", 0, False
        self._fault = ""
        """Why the take's file could not be written the last time."""
        self._budget = stage.size
        stage.show = self._look

    def _app(self) -> web.Application:
        app = web.Application(client_max_size=1024)
        app.router.add_get("/ws", self._socket)
        for path in FILES:
            app.router.add_get(path, self._file)
        app.router.add_route("*", "/{anything:.*}", self._nothing)
        return app

    def _new_protocol(self) -> asyncio.BaseProtocol:
        serve = self._runner.server
        assert serve is not None
        return serve()

    async def run(self, listener: socket.socket, context: ssl.SSLContext | None = None) -> None:
        """Serve who connects to `listener`, and tell the pages how things are, until cancelled."""
        await self._runner.setup()
        taking = asyncio.create_task(self.connections.take(listener, context))
        try:
            await self._tick()
        finally:
            taking.cancel()
            self._write()

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(STATUS_S)
            driver, driving = self._driver, self.driving
            if driver is not None and time.monotonic() - driver.heard > SILENCE_S and driving.pause():
                self._say(f"paused: the page was silent for {SILENCE_S:g} s")
            self._write()
            self._tell_all(self._status())

    async def finish_saving(self) -> None:
        """Wait for a take that is being saved."""
        if self._saving is not None:
            await self._saving

    async def close(self) -> None:
        """Send all pages away, and end all connections: seconds at most."""
        await asyncio.gather(*(client.close("the server ends") for client in self._clients))
        await self._runner.cleanup()

    # --- requests -----------------------------------------------------------------------------------------------------

    def _refused(self, request: web.Request, socket: bool = False) -> web.Response | None:
        """The answer to who may not come in; None for who may."""
        token, origin = request.query.get("token", ""), request.headers.get("Origin")
        why = self._gate.refuses(token, request.host or "", origin, socket)
        if not why:
            self.connections.admit(request.transport)
            return None
        self._quiet.dropped(why, _whose(request))
        headers = {**_HEADERS, "Content-Security-Policy": _REFUSED_POLICY}
        return web.Response(status=403, text=_REFUSED, content_type="text/html", headers=headers)

    async def _nothing(self, request: web.Request) -> web.Response:
        return self._refused(request) or web.Response(status=404, text="nothing here", headers=_HEADERS)

    async def _file(self, request: web.Request) -> web.Response:
        refused = self._refused(request)
        if refused is not None:
            return refused
        name, kind = FILES[request.path]
        text = resources.files("generator.teleop").joinpath("static", name).read_text("utf-8")
        for ending in (".js", ".css"):  # what a file names is asked for with the token, too
            text = text.replace(f'{ending}"', f'{ending}?token={self._gate.token}"')
        policy = (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; base-uri 'none'; "
            f"connect-src 'self' ws://{request.host} wss://{request.host}; form-action 'none'; frame-ancestors 'none'"
        )
        return web.Response(text=text, content_type=kind, headers={**_HEADERS, "Content-Security-Policy": policy})

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        refused = self._refused(request, socket=True)
        if refused is not None:
            return refused
        if request.query.get("v") != wire.VERSION:
            return web.Response(status=400, text=f"expected v={wire.VERSION}", headers=_HEADERS)
        if len(self._clients) >= MAX_PAGES:
            self._quiet.dropped(f"more than {MAX_PAGES} pages", _whose(request))
            return web.Response(status=503, text="too many pages", headers=_HEADERS)
        channel = web.WebSocketResponse(max_msg_size=_FRAME_BYTES, compress=False, heartbeat=10.0)
        await channel.prepare(request)
        self._count += 1
        client = Client(channel, f"page {self._count}", self._stage)
        self._clients.append(client)
        self._log(f"{client.name} came, of {_whose(request)}")
        if self._driver is None:
            self._drive(client)
        else:
            client.tell(self._hello(client))
        client.tell(self._status())
        sending = asyncio.create_task(client.send())
        try:
            async for message in channel:
                if not self._heard(client, message):
                    break
        finally:
            sending.cancel()
            self._left(client)
        return channel

    # --- what pages say -----------------------------------------------------------------------------------------------

    def _heard(self, client: Client, message: WSMessage) -> bool:
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
        if isinstance(said, wire.Seen):
            client.has_seen(said.count)
        elif isinstance(said, wire.Ping):
            client.clock.heard(1e-3 * said.time_ms, now)
            client.heard = now
            if client is self._driver and said.latency_ms is not None:
                self.latency_ms = said.latency_ms
            client.tell({"type": "pong", "time": said.time_ms, "server": now})
        elif isinstance(said, wire.Do) and said.what == "drive":
            if self._driver is None:
                self._drive(client)
        elif client is not self._driver:
            if isinstance(said, wire.Move | wire.Do):
                return self._bad(client, "a page that only watches would drive")
        elif isinstance(said, wire.Move):
            self._move(client, said, now)
        elif isinstance(said, wire.View):
            self._stage.resize(live_size(*self._budget, said.width / said.height))
            self._tell_all({"type": "size", "width": self._stage.size[0], "height": self._stage.size[1]})
        else:
            self._do(said.what)
        return True

    def _bad(self, client: Client, why: str) -> bool:
        client.bad += 1
        self._quiet.dropped(why, client.name)
        if client.bad >= MOST_BAD:
            self._log(f"{client.name} is sent away after {client.bad} bad messages")
            return False
        return True

    def _move(self, client: Client, move: wire.Move, now: float) -> None:
        client.heard = now
        client.clock.heard(1e-3 * move.time_ms, now)
        if move.n <= client.n:
            client.late += 1
            return
        client.n = move.n
        if self.driving.move(move, client.clock.at(1e-3 * move.time_ms)):
            self._stage.want(self.driving.place, Mark(client, move.n, move.time_ms))
        if self.driving.is_full and self.driving.pause():
            self._say("paused: a take cannot be longer; save it")

    def _write(self) -> None:
        """Bring the file of the take to what was recorded; what hinders it is said once."""
        if self._saving is not None:
            return
        fault = ""
        try:
            self._takes.write(self.driving)
        except FreeArtError as error:
            fault = str(error)
        if fault and fault != self._fault:
            self._log(f"the take is kept in memory alone: {fault}")
            self._say(f"the take is kept in memory alone: {fault}", alarm=True)
        self._fault = fault

    def _do(self, what: str) -> None:
        driving, epoch = self.driving, self.driving.epoch
        if self._saving is not None:
            self._say("the take is being saved")
        elif what == "record":
            if self._driver is not None:
                self._driver.clock.steady()
            self._say("recording goes on from where it was" if driving.record() else "recording")
        elif what == "pause" and driving.pause():
            self._say("paused: move freely, going on returns the object to where it is now")
        elif what == "undo":
            gone = driving.undo()
            self._say(f"the last {gone:.1f} s are undone" if gone else "there is nothing to undo")
        elif what == "reset":
            driving.reset()
            self._say("back at the beginning")
        elif what == "save":
            self._begin_saving()
        self._write()
        if driving.epoch != epoch:
            self._tell_all({"type": "place", "epoch": driving.epoch, **_numbers(driving.place)})
            self._stage.want(driving.place, Mark())

    def _begin_saving(self) -> None:
        self.driving.pause()
        if self.driving.has_take:
            self._saving = asyncio.create_task(self._save())
        else:
            self._say("there is no take to save: record one")

    async def _save(self) -> None:
        """Write the take in a thread: one of an hour takes seconds, and the picture goes on."""
        driving = self.driving
        try:
            path = await asyncio.to_thread(self._takes.save, driving)
        except FreeArtError as error:
            self._log(f"not saved: {error}")
            self._say(f"not saved: {error}. The take is kept: press save again", alarm=True)
        else:
            self._log(f"saved {path} ({driving.take.seconds:.1f} s, {len(driving.take)} samples)")
            self._say(f"saved as {path.name}, {driving.take.seconds:.1f} s")
            driving.saved()
            self._tell_all(self._status())
        finally:
            self._saving = None

    # --- who drives ---------------------------------------------------------------------------------------------------

    def _drive(self, client: Client) -> None:
        self._driver, client.n = client, -1
        client.heard = time.monotonic()
        self._log(f"{client.name} drives")
        client.tell(self._hello(client))

    def _left(self, client: Client) -> None:
        self._clients.remove(client)
        late = f"; {client.late} of its moves came out of order and were dropped" if client.late else ""
        self._log(f"{client.name} has left{late}")
        if client is self._driver:
            self._driver = None
            if self.driving.pause():
                self._say("paused: the driver's page has gone")

    # --- what pages are told ------------------------------------------------------------------------------------------

    def _say(self, notice: str, alarm: bool = False) -> None:
        self._notice, self._alarm = notice, alarm
        self._notices += 1
        self._tell_all(self._status())

    def _tell_all(self, message: dict[str, Any]) -> None:
        for client in self._clients:
            client.tell(message)

    def _look(self) -> None:
        for client in self._clients:
            client.look()

    def _hello(self, client: Client) -> dict[str, Any]:
        driving = self.driving
        return {
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
            "latency_ms": None if self.latency_ms is None else self.latency_ms[0],
            "driven": self._driver is not None,
            "watchers": len(self._clients) - (self._driver is not None),
            "file": self._takes.next_name(),
            "notice": self._notice or None,
            "notice_n": self._notices,
            "alarm": self._alarm,
        }


def _numbers(place: Placement) -> dict[str, Any]:
    return {"position": place.T[:3, 3].tolist(), "quaternion": se3.wxyz(place.T).tolist(), "state": place.state}


def _whose(request: web.Request) -> str:
    return wire.printable(request.remote or "somebody")
