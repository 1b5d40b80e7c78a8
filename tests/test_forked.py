"""A process a request: each begins anew, and what becomes of one is its own affair."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from leaderboard import forked
from leaderboard.forked import Crashed, TimedOut


@pytest.fixture(scope="module")
def server():
    made = forked.Server("process_replies")
    yield made
    made.close()


@pytest.fixture
def ask(server, tmp_path):
    return lambda do, limit_s=60.0: server.ask({"do": do}, tmp_path, limit_s)


def test_each_request_has_a_process_that_knows_nothing_of_the_others(ask, tmp_path):
    first, second = ask("answer"), ask("answer")
    assert first["asked"] == second["asked"] == 1 and first["pid"] != second["pid"]
    assert first["place"] == str(tmp_path) and first["threads"] == "1"


@pytest.mark.parametrize(
    "do, line",
    [
        ("abort", "exit code -6: about to break"),
        ("leave", "exit code 0: no message"),
        ("raise", "exit code 1: ValueError: not caught"),
    ],
)
def test_a_process_that_ends_without_an_answer_is_reported_and_the_next_one_answers(server, ask, do, line):
    waiting = ask("answer") and server._process.pid
    with pytest.raises(Crashed, match=line):
        ask(do)
    assert ask("answer")["asked"] == 1 and server._process.pid == waiting


def test_one_that_takes_too_long_is_ended(server, ask):
    with pytest.raises(TimedOut):
        ask("hang", 0.5)
    assert ask("answer")["asked"] == 1
    assert not _children(server._process.pid)


def test_long_answers_and_whatever_is_printed_between_arrive_apart(ask):
    assert ask("talk") == {"much": "y" * 300_000}


def test_a_waiting_process_that_was_killed_is_replaced(server, ask):
    ask("answer")
    server._process.kill()
    server._process.wait()
    assert ask("answer")["asked"] == 1


def test_a_child_that_asks_forks_itself_and_ends_with_what_it_has_forked(server, ask):
    inner = ask("ask")
    assert inner["asked"] == 2 and inner["parent"] != server._process.pid
    with pytest.raises(TimedOut):
        ask("ask a hanging one", 2.0)
    _until(lambda: not _descendants(server._process.pid))


def test_an_ended_server_gives_up_what_it_waits_for(tmp_path):
    server = forked.Server("process_replies")
    server.ask({"do": "answer"}, tmp_path, 60.0)
    waiting = threading.Timer(1.0, server.end)
    waiting.start()
    with pytest.raises(Crashed):
        server.ask({"do": "hang"}, tmp_path, 600.0)
    with pytest.raises(Crashed, match="stopped"):
        server.ask({"do": "answer"}, tmp_path, 60.0)
    server.close()


def test_nothing_outlives_the_parent(tmp_path):
    """Killed outright in the middle of a request, the parent leaves neither the waiting process nor its children."""
    program = (
        f"import sys; sys.path[:] = {[p for p in sys.path if p]!r}\n"
        "from pathlib import Path\nfrom leaderboard import forked\n"
        "server = forked.Server('process_replies')\n"
        f"ask = lambda do: server.ask({{'do': do}}, Path({str(tmp_path)!r}), 600)\n"
        "ask('answer'); print(server._process.pid, flush=True); ask('ask a hanging one')\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    waiting = int(parent.stdout.readline())
    _until(lambda: len(_descendants(waiting)) == 2)
    children = _descendants(waiting)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    _until(lambda: not any(map(_alive, (waiting, *children))))


def _until(holds) -> None:
    for _ in range(600):
        if holds():
            return
        time.sleep(0.1)
    pytest.fail("it did not come to that")


def _stat(pid: int) -> list[str]:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return []


def _alive(pid: int) -> bool:
    return bool(fields := _stat(pid)) and fields[0] != "Z"


def _children(pid: int) -> list[int]:
    every = [int(place.name) for place in Path("/proc").glob("[0-9]*")]
    return [one for one in every if (fields := _stat(one)) and int(fields[1]) == pid and fields[0] != "Z"]


def _descendants(pid: int) -> list[int]:
    return [one for child in _children(pid) for one in (child, *_descendants(child))]
