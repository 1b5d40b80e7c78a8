"""Nothing is lost: a command replaces an older output of its own and nothing else, and two never write one place."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path

import pytest
from another_python import ROOT, run_python
from refusal import assert_refused
from stopped_commands import stop
from synthetic_case import make_recording, make_truth, truth_as_answer

from export.commands import export
from freeart21 import cli
from freeart21.commands import view
from freeart21.errors import FreeArtError
from freeart21.files import atomic, places
from freeart21.files.benchmark import write_benchmark
from freeart21.files.lock import only_writer
from freeart21.files.result import Method, write_own_method, write_result
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.reconstruction import Failure
from generator.commands import RecordOptions, convert, record
from leaderboard import commands
from reconstruct.commands import reconstruct
from reconstruct.settings import ReconstructSettings
from simgap.commands import gap, replay

QUIET = ReconstructSettings(progress=False)


def bytes_of(folder: Path) -> dict[str, bytes]:
    """File name to content of all in a folder, links and hidden ones too."""
    return {
        str(path.relative_to(folder)): str(path.readlink()).encode() if path.is_symlink() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


def write_home(folder: Path) -> Path:
    """A data folder of one sequence, the results of a method for it, and somebody's thesis."""
    truth = make_truth()
    write_sequence(folder / "data" / "sequences" / "a", make_recording(truth, "a"), 1e-4)
    write_truth(folder / "data" / "truth" / "a", truth, 2)
    write_benchmark(folder / "data", "d", "1", "public")
    write_result(folder / "results" / "ours" / "a", truth_as_answer(truth))
    (folder / "thesis").mkdir()
    (folder / "thesis" / "chapter1.tex").write_text("years of work")
    (folder / "thesis.pdf").write_bytes(b"%PDF years of work")
    (folder / "link").symlink_to(folder / "thesis")
    (folder / "shortcut").symlink_to(folder / "thesis.pdf")
    return folder


@pytest.fixture
def home(tmp_path: Path) -> Path:
    return write_home(tmp_path)


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same for tests that compare it before and after."""
    return write_home(tmp_path_factory.mktemp("home"))


COMMANDS: dict[str, Callable[[Path, Path], object]] = {
    "demo": lambda home, out: cli.demo(out=out),
    "record": lambda home, out: record(RecordOptions(("stapler",), out)),
    "reconstruct": lambda home, out: reconstruct(home / "data/sequences/a", out, settings=QUIET),
    "export": lambda home, out: export(home / "results/ours/a", out),
    "gap": lambda home, out: gap(home / "data", home / "results", out),
    "replay": lambda home, out: replay(home / "data", (home / "results",), out),
    "measure": lambda home, out: cli.measure((home / "data/truth/a",), out),
    "convert": lambda home, out: convert(home / "data/sequences/a", out, "official"),
    "view": lambda home, out: view(home / "results/ours/a", out),
    "score": lambda home, out: commands.score(home / "results/ours", home / "data", out=out),
}
FILES = ("view", "score")


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    "out",
    ["thesis", "thesis.pdf", "thesis.pdf/below", "link", "shortcut", "data/sequences/a", "data/sequences/new", "."],
)
def test_what_is_no_older_output_is_refused_and_left_as_it_is(untouched: Path, command: str, out: str) -> None:
    before = bytes_of(untouched)
    with pytest.raises(FreeArtError) as caught:
        COMMANDS[command](untouched, untouched / out)
    assert "\n" not in str(caught.value) and str(untouched / out) in str(caught.value)
    assert bytes_of(untouched) == before


@pytest.mark.parametrize(
    "command, out",
    [
        ("reconstruct", "data/sequences"),
        ("reconstruct", "data"),
        ("reconstruct", "data/sequences/a/result"),
        ("convert", "data/sequences/a/official"),
        ("export", "results/ours/a"),
        ("export", "results/ours/a/parts"),
        ("export", "results/ours/a/urdf"),
        ("measure", "data/truth/a/set"),
        ("gap", "data/gap"),
        ("replay", "data/replay"),
        ("view", "results/ours/a/page.html"),
        ("view", "results/ours/a/prediction.json"),
        ("score", "data/scores.json"),
        ("score", "data/benchmark.json"),
    ],
)
def test_nothing_is_written_over_around_or_into_what_is_read(untouched: Path, command: str, out: str) -> None:
    before = bytes_of(untouched)
    with pytest.raises(FreeArtError):
        COMMANDS[command](untouched, untouched / out)
    assert bytes_of(untouched) == before


def test_a_folder_that_may_not_be_written_is_one_line(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shut = home / "shut"
    shut.mkdir()
    own = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != shut and own(path, mode))  # root may write all
    for name, command in COMMANDS.items():
        assert_refused("no permission to write", command, home, shut / "out" / ("x.json" if name in FILES else "x"))
    assert not list(shut.iterdir())


def test_an_older_result_is_replaced_with_its_asset(home: Path) -> None:
    result = home / "results" / "ours" / "a"
    (result / "asset" / "meshes").mkdir(parents=True)
    atomic.write_json(result / "asset" / "asset.json", {"files": ["meshes/moving_hull_00.obj"]})
    (result / "asset" / "meshes" / "moving_hull_00.obj").write_text("")
    write_result(result, Failure("tracks", "too dark"))
    assert [path.name for path in result.iterdir()] == ["prediction.json"]
    assert [path.name for path in result.parent.iterdir()] == ["a"]


@pytest.mark.parametrize("notes", ["notes.txt", "parts/moving.blend", "part_mask/mine.png", "asset/robot.urdf"])
def test_an_older_result_that_holds_something_of_the_users_is_kept(home: Path, notes: str) -> None:
    result = home / "results" / "ours" / "a"
    (result / notes).parent.mkdir(exist_ok=True)
    (result / notes).write_text("mine")
    before = bytes_of(home)
    with pytest.raises(FreeArtError, match=f"older result, but {notes} in it would be lost"):
        reconstruct(home / "data/sequences/a", result, settings=QUIET)
    assert bytes_of(home) == before


def test_pages_and_tables_replace_only_their_like(home: Path) -> None:
    write_result(home / "results/ours/a", Failure("tracks", "too dark"))
    page, table = home / "page.html", home / "scores.json"
    for _ in range(2):
        COMMANDS["view"](home, page)
        COMMANDS["score"](home, table)
    assert json.loads(table.read_text())["schema"] == "freeart21/scores/2"
    for command, like, other in (("score", table, page), ("view", page, table)):
        copy = Path(shutil.copy(other, home / f"copy{like.suffix}"))
        assert_refused("exists and is no older", COMMANDS[command], home, copy)
        assert copy.read_bytes() == other.read_bytes()


def test_what_changed_while_a_command_ran_is_seen_at_its_end(tmp_path: Path) -> None:
    with pytest.raises(FreeArtError, match="is no older result"), atomic.new_folder(tmp_path / "r", places.RESULT) as a:
        (a / "new").write_text("")
        (tmp_path / "r").mkdir()
        (tmp_path / "r" / "mine").write_text("x")
    assert bytes_of(tmp_path) == {"r/mine": b"x"}


# --- method.json ------------------------------------------------------------------------------------------------------

OURS = Method("ours", "freeart21 0.1.0, solver 1")


def test_method_json_is_written_beside_results_alone(home: Path) -> None:
    assert write_own_method(home / "results" / "ours", OURS)
    assert write_own_method(home / "results" / "ours", OURS)  # over our own
    for folder in (home, home / "thesis"):
        before = bytes_of(folder)
        assert not write_own_method(folder, OURS)
        assert bytes_of(folder) == before


def test_the_method_json_of_another_method_stays(home: Path) -> None:
    path = home / "results" / "ours" / "method.json"
    atomic.write_json(path, {"schema": "freeart21/method/1", "name": "theirs", "code": "https://example.org 2"})
    before = path.read_bytes()
    assert not write_own_method(path.parent, OURS) and path.read_bytes() == before
    path.write_text("mine")
    assert not write_own_method(path.parent, OURS) and path.read_text() == "mine"


# --- one writer -------------------------------------------------------------------------------------------------------

HOLD = (
    "import sys, time; from pathlib import Path; from freeart21.files.lock import only_writer\n"
    "with only_writer(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
)


@pytest.mark.parametrize("command, out", [("reconstruct", "results/ours/a"), ("export", "asset"), ("gap", "gap")])
def test_a_second_writer_of_one_folder_is_refused_and_a_killed_one_leaves_no_lock(
    home: Path, command: str, out: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from simgap import workflow

    for name in ("read_measured", "read_asset"):
        monkeypatch.setattr(workflow, name, lambda *_, **__: types.SimpleNamespace(joint="j"))
    monkeypatch.setattr(workflow, "explain", lambda *_: pytest.fail("began"))
    before = bytes_of(home)
    first = subprocess.Popen(
        [sys.executable, "-c", HOLD, home / out], env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE
    )
    assert first.stdout.readline() == b"held\n"
    try:
        assert_refused(f"another process is writing .*{out}; wait for it", COMMANDS[command], home, home / out)
    finally:
        first.send_signal(signal.SIGKILL)
        first.wait()
    with only_writer(home / out):
        pass
    assert bytes_of(home) == before


def test_what_a_killed_writer_left_is_cleared_up_and_the_old_folder_gets_its_name_back(home: Path) -> None:
    result = home / "results" / "ours" / "a"
    before = bytes_of(result)
    old, aside = result.parent / ".a.0123abcd.old", result.parent / ".a.zyxw9876.part"
    other = result.parent / ".a.b.0123abcd.part"
    for folder in (old, aside, other):
        folder.mkdir()
    result.replace(old / "a")  # killed between the two renames
    (aside / "half").write_text("")
    with only_writer(result):
        assert bytes_of(result) == before
    assert sorted(path.name for path in result.parent.iterdir()) == [".a.b.0123abcd.part", "a"]


# --- unfinished, and faults of our own --------------------------------------------------------------------------------


NATIVE = """
import os, signal, sys
from freeart21 import __main__, cli
from freeart21.errors import FreeArtError
class Renderer:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGSEGV)
renderer = Renderer()
def main():
    print("the output")
    {code}
cli.main = main
__main__.main()
"""


@pytest.mark.parametrize(
    "code, status, message",
    [
        ("pass", 0, ""),
        ("sys.exit(3)", 3, ""),
        ("raise FreeArtError('no space')", 1, "freeart21: no space"),
        ("raise TypeError('one\\ntwo')", 70, "freeart21: internal error: TypeError: one two"),
        ("raise MemoryError", 1, "freeart21: out of memory"),
        ("open('/nonexistent/x')", 1, "freeart21: /nonexistent/x: No such file or directory"),
        (
            "import shutil; raise shutil.Error([('/a', '/b', \"[Errno 28] No space left on device: '/b'\")] * 900)",
            1,
            "freeart21: No space left on device (/b and 899 more files)",
        ),
        ("raise KeyboardInterrupt", 130, "freeart21: stopped"),
        ("os.kill(os.getpid(), signal.SIGTERM); signal.pause()", 143, "freeart21: stopped"),
    ],
)
def test_whatever_happens_is_one_line_before_native_libraries_are_taken_down(
    code: str, status: int, message: str
) -> None:
    """The simulator's crash then: after the last word, and in place of the exit code."""
    done = run_python("-c", NATIVE.format(code=code))
    assert done.returncode == status and done.stdout == "the output\n", done.stderr
    assert done.stderr.startswith(message) and len(done.stderr.splitlines()) == bool(message)
    if status == 70:
        assert "Traceback" in run_python("-c", NATIVE.format(code=code), FREEART21_TRACEBACK="1").stderr


# --- stop signals -----------------------------------------------------------------------------------------------------

HIDDEN = """
import os, signal, sys, time
from freeart21 import processes
from freeart21.processes import report_errors
processes.listen()
class Dropping:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
def native():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    except KeyboardInterrupt as error:
        raise SystemError("returned a result with an exception set") from error
with report_errors():
    {code}
"""


@pytest.mark.parametrize(
    "code",
    [
        "native()",  # as compiled code does
        "x = Dropping(); del x; time.sleep(5)",  # raised where Python drops it
        "os.kill(os.getpid(), signal.SIGTERM); time.sleep(5)",
        # dropped by everybody, and then something is to be written
        "from pathlib import Path; from freeart21.files import atomic\n"
        "    try: native()\n    except SystemError: atomic.write_bytes(Path(sys.argv[1]), b'wrong')",
    ],
)
def test_an_interrupt_arrives_whatever_became_of_it(tmp_path: Path, code: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", HIDDEN.format(code=code), tmp_path / "x"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert done.returncode == (143 if "SIGTERM" in code else 130), done.stderr
    assert done.stderr == "freeart21: stopped\n" and not list(tmp_path.iterdir())


SMALL = ["--width", "160", "--height", "120", "--queries", "2", "--shader", "trivial"]
STOPPED = {
    "record": ["record", "stapler", "--frames", "20", *SMALL, "--out", "data"],
    "convert": ["convert", "../data/sequences/a", "--to", "official", "--out", "official"],
}


@pytest.mark.parametrize("command", STOPPED)
def test_a_stopped_command_leaves_nothing_unfinished(home: Path, command: str) -> None:
    codes = []
    for k, files in enumerate((1, 12)):
        code, wrong = stop(STOPPED[command], home / f"out{k}", files, to_all=bool(k), twice=bool(k))
        assert not wrong
        codes.append(code)
    assert 130 in codes
