"""The page on which clicks correct masks: what it answers, to whom, and that it ends by saving."""

from __future__ import annotations

import http.client
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from freeart21.errors import FreeArtError
from freeart21.files.masks import Masks
from freeart21.view.click_page import MAX_BYTES, ClickServer

N, H, W = 5, 40, 60


def solve(points) -> Masks:
    if any(on for *_, on in points) and len(points) > 2:
        raise FreeArtError("too many for this test")
    masks = np.zeros((N, H, W), bool)
    for frame, column, row, on in points:
        masks[frame, int(row) - 3 : int(row) + 3, int(column) - 3 : int(column) + 3] = on
    return Masks(masks, np.linspace(0, 1, N), ("far",) * N)


@pytest.fixture
def server() -> Iterator[ClickServer]:
    made = ClickServer(lambda i: np.full((H, W, 3), 40 * i, np.uint8), solve, "a <b>lid</b>", N)
    thread = threading.Thread(target=made.serve, daemon=True)
    thread.start()
    yield made
    made._server.shutdown()
    thread.join(10)


def ask(server: ClickServer, path: str, body: object = None, token: str | None = None, **headers: str):
    """(status, bytes) of a GET, or of a POST when there is a body."""
    place = urlsplit(server.address)
    link = http.client.HTTPConnection(place.hostname, place.port, timeout=10)
    token = place.query if token is None else f"token={token}"
    text = body if isinstance(body, str) else None if body is None else json.dumps(body)
    link.request("GET" if body is None else "POST", f"{path}?{token}", text, headers)
    answer = link.getresponse()
    return answer.status, answer.read()


def test_clicks_are_solved_shown_undone_and_saved(server):
    state = json.loads(ask(server, "/state")[1])
    assert state["frames"] == N and state["doubt"][-1] == 1 and state["clicks"] == []
    before = cv2.imdecode(np.frombuffer(ask(server, "/frame/4")[1], np.uint8), 1)
    code, text = ask(server, "/click", {"frame": 4, "column": 20.5, "row": 10, "on_object": True})
    assert code == 200 and json.loads(text)["clicks"] == [[4, 20.5, 10.0, True]]
    after = cv2.imdecode(np.frombuffer(ask(server, "/frame/4")[1], np.uint8), 1)
    assert after.shape == (H, W, 3) and np.abs(after.astype(int) - before)[5:15, 15:26].max() > 40
    assert np.abs(after.astype(int) - before)[25:, 35:].max() < 30
    assert json.loads(ask(server, "/undo", {})[1])["clicks"] == []
    ask(server, "/click", {"frame": 1, "column": 5, "row": 5, "on_object": False})
    assert ask(server, "/save", {})[0] == 200
    assert server.saved and server.clicks == [(1, 5.0, 5.0, False)]


def test_clicks_without_an_answer_are_not_taken(server):
    for k in range(2):
        ask(server, "/click", {"frame": k, "column": 5, "row": 5, "on_object": True})
    state = json.loads(ask(server, "/click", {"frame": 3, "column": 5, "row": 5, "on_object": True})[1])
    assert "too many for this test" in state["message"] and len(state["clicks"]) == 2


@pytest.mark.parametrize("path", ["/", "/frame/0"])
def test_without_the_token_or_under_another_name_nothing_is_answered(server, path: str):
    assert ask(server, path)[0] == 200
    assert ask(server, path, token="wrong")[0] == 403
    assert ask(server, path, Host="evil.example")[0] == 403
    for other in ("/frame/99", "/frame/../state", "/etc/passwd"):
        assert ask(server, other)[0] == 404


@pytest.mark.parametrize(
    "body",
    [
        "no json",
        {"frame": 0},
        {"frame": 99, "column": 1, "row": 1, "on_object": True},
        {"frame": 0, "column": float("nan"), "row": 1, "on_object": True},
        "1" * (MAX_BYTES + 1),
    ],
)
def test_a_bad_request_is_refused_and_changes_nothing(server, body):
    assert ask(server, "/click", body)[0] == 400
    assert ask(server, "/click", {"frame": 0, "column": 1, "row": 1, "on_object": True}, token="wrong")[0] == 400
    assert server.clicks == [] and ask(server, "/state")[0] == 200


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")
def test_the_page_is_drawn(server, tmp_path: Path):
    picture = tmp_path / "page.png"
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=412,800"]
    command += ["--virtual-time-budget=4000", f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}"]
    subprocess.run([*command, server.address], check=False, capture_output=True, timeout=120)
    shown = cv2.imread(str(picture))
    assert shown is not None and (np.abs(shown.astype(int) - (0, 94, 213)).sum(-1) < 30).any()  # a bar of doubt
