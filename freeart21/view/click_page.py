"""Masks corrected by clicks: a page on this machine alone, served until the user saves."""

from __future__ import annotations

import hmac
import json
import secrets
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files.masks import Click, Masks
from freeart21.view.document import static_text
from freeart21.view.masks_page import lit_up
from freeart21.view.video import jpeg_bytes

HOST = "127.0.0.1"
MAX_BYTES = 4096
"""Of a request's body."""
MAX_CLICKS = 500
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; connect-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
}


@dataclass
class ClickServer:
    """The page's server; `address` has the token without which nothing is answered."""

    picture: Callable[[int], NDArray[np.uint8]]
    """(h, w, 3) RGB of a frame."""
    solve: Callable[[Sequence[Click]], Masks]
    """Masks after clicks; FreeArtError is shown on the page."""
    title: str
    frames: int
    port: int = 0
    clicks: list[Click] = field(default_factory=list)
    answer: Masks | None = None
    saved: bool = False

    def __post_init__(self) -> None:
        self._token, self._lock = secrets.token_urlsafe(18), threading.Lock()
        self._message = ""
        self._update([])
        answers = {"do_GET": lambda request: self._get(request), "do_POST": lambda request: self._post(request)}
        handler = type("Handler", (BaseHTTPRequestHandler,), {**answers, "log_message": lambda *_: None})
        try:
            self._server = ThreadingHTTPServer((HOST, self.port), handler)
        except OSError as error:
            raise FreeArtError(f"port {self.port} of {HOST} cannot be opened: {error.strerror}") from error
        self._server.daemon_threads = True

    @property
    def address(self) -> str:
        """Of the page, with its token."""
        return f"http://{HOST}:{self._server.server_address[1]}/?token={self._token}"

    def serve(self) -> None:
        """Masks until the page saves."""
        try:
            self._server.serve_forever(poll_interval=0.1)
        finally:
            self._server.server_close()

    def _update(self, clicks: list[Click]) -> None:
        """Take these clicks; where they give no masks those before stay, and the page shows why."""
        try:
            self.answer, self._message = self.solve(clicks), ""
            self.clicks = clicks
        except FreeArtError as error:
            self._message = str(error)
            self.clicks = clicks if self.answer is None else self.clicks

    def _state(self) -> dict[str, Any]:
        answer = self.answer
        doubt = [] if answer is None else [round(float(d), 2) for d in answer.doubt]
        reasons = [] if answer is None else list(answer.reasons)
        return {"clicks": self.clicks, "doubt": doubt, "reasons": reasons, "message": self._message}

    def _allowed(self, request: BaseHTTPRequestHandler) -> bool:
        """Whether a request is of this page: its host is ours (no other name leads here), and it has the token."""
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        host = request.headers.get("Host", "")
        ours = host == f"{HOST}:{self._server.server_address[1]}"
        return ours and hmac.compare_digest(given.encode(), self._token.encode())

    def _get(self, request: BaseHTTPRequestHandler) -> None:
        path = urlsplit(request.path).path
        if not self._allowed(request):
            _reply(request, 403, b"open the address that the terminal printed", "text/plain")
        elif path == "/":
            _reply(request, 200, static_text("click.html").encode(), "text/html; charset=utf-8")
        elif path == "/state":
            with self._lock:
                state = {**self._state(), "title": self.title, "frames": self.frames}
            _reply(request, 200, json.dumps(state).encode(), "application/json")
        elif path in {f"/frame/{i}" for i in range(self.frames)}:
            with self._lock:
                content = self._draw(int(path.removeprefix("/frame/")))
            _reply(request, 200, content, "image/jpeg")
        else:
            _reply(request, 404, b"there is no such page", "text/plain")

    def _draw(self, frame: int) -> bytes:
        """JPEG of a frame with the mask lit up and outlined, in the recording's pixels, and the clicks in it."""
        picture = np.ascontiguousarray(self.picture(frame))
        if self.answer is not None:
            picture = lit_up(picture, self.answer.masks[frame].astype(np.uint8), max(1, picture.shape[1] // 400))
        for at, column, row, on_object in self.clicks:
            if at == frame:
                radius = max(3, picture.shape[1] // 120)
                colour = (0, 220, 90) if on_object else (255, 60, 40)
                cv2.circle(picture, (round(column), round(row)), radius, colour, -1)
                cv2.circle(picture, (round(column), round(row)), radius, (255, 255, 255), 1)
        return jpeg_bytes(picture, 85)

    def _post(self, request: BaseHTTPRequestHandler) -> None:
        path = urlsplit(request.path).path
        try:
            length = int(request.headers.get("Content-Length", ""))
            if not self._allowed(request) or not 0 <= length <= MAX_BYTES:
                raise ValueError("not of this page")
            body = json.loads(request.rfile.read(length) or b"{}")
            with self._lock:
                if path == "/click":
                    if len(self.clicks) >= MAX_CLICKS:
                        raise ValueError(f"there are {MAX_CLICKS} clicks")
                    column, row = float(body["column"]), float(body["row"])
                    if not (np.isfinite(column) and np.isfinite(row)):
                        raise ValueError("column and row are no numbers")
                    if not 0 <= int(body["frame"]) < self.frames:
                        raise ValueError(f"frame is {body['frame']}, expected 0 to {self.frames - 1}")
                    self._update([*self.clicks, Click(int(body["frame"]), column, row, bool(body["on_object"]))])
                elif path == "/undo":
                    self._update(self.clicks[:-1])
                elif path == "/save" and self.answer is not None:
                    self.saved = True
                    threading.Thread(target=self._server.shutdown, daemon=True).start()
                else:
                    raise ValueError("there is nothing to do")
                state = self._state()
        except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
            _reply(request, 400, f"refused: {error}".encode(), "text/plain")
            return
        _reply(request, 200, json.dumps(state).encode(), "application/json")


def _reply(request: BaseHTTPRequestHandler, code: int, content: bytes, kind: str) -> None:
    headers = {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}
    request.send_response(code)
    for name, value in headers.items():
        request.send_header(name, value)
    request.end_headers()
    request.wfile.write(content)
