"""A process an asset: each begins anew, and what becomes of one is its own affair."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from leaderboard import asset_process
from leaderboard.asset_process import Crashed, TimedOut


@pytest.fixture
def ask(tmp_path):
    return lambda do, limit_s=60.0: asset_process.ask("process_replies", {"do": do}, tmp_path, limit_s)


def test_each_request_has_a_process_that_knows_nothing_of_the_others(ask, tmp_path):
    first, second = ask("answer"), ask("answer")
    assert first["asked"] == second["asked"] == 1 and first["pid"] != second["pid"]
    assert first["place"] == str(tmp_path) and first["threads"] == "1"


@pytest.mark.parametrize(
    "do, line",
    [("abort", "exit code -6: about to break"), ("leave", "exit code 0: no message"), ("raise", "exit code 70: ")],
)
def test_a_process_that_ends_without_an_answer_is_reported_and_the_next_one_answers(ask, do, line):
    waiting = ask("answer") and asset_process._server.process.pid
    with pytest.raises(Crashed, match=line):
        ask(do)
    assert ask("answer")["asked"] == 1 and asset_process._server.process.pid == waiting


def test_one_that_takes_too_long_is_ended(ask):
    with pytest.raises(TimedOut):
        ask("hang", 0.5)
    assert ask("answer")["asked"] == 1
    assert not _children(asset_process._server.process.pid)


def test_long_answers_and_whatever_is_printed_between_arrive_apart(ask):
    assert ask("talk") == {"much": "y" * 300_000}


def test_a_waiting_process_that_was_killed_is_replaced(ask):
    ask("answer")
    asset_process._server.process.kill()
    asset_process._server.process.wait()
    assert ask("answer")["asked"] == 1


def test_nothing_outlives_the_parent(tmp_path):
    """Killed outright in the middle of a request, the parent leaves neither the waiting process nor its child."""
    program = (
        f"import sys, threading; sys.path[:] = {[p for p in sys.path if p]!r}\n"
        "from pathlib import Path\nfrom leaderboard import asset_process\n"
        "ask = lambda do: asset_process.ask('process_replies', {'do': do}, Path(" + repr(str(tmp_path)) + "), 600)\n"
        "ask('answer'); print(asset_process._server.process.pid, flush=True); ask('hang')\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    waiting = int(parent.stdout.readline())
    _until(lambda: _children(waiting))
    (child,) = _children(waiting)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    _until(lambda: not any(map(_alive, (waiting, child))))


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
