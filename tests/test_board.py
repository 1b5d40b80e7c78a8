"""A board in a repository: three submissions from pull request to published site, and what a board must refuse."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from board_case import (
    PASSPHRASE,
    SEQUENCES,
    commit,
    gamed,
    git,
    write_answers,
    write_halves,
    write_program,
    write_traversal,
    zip_results,
)
from browser import CHROMIUM, browser
from command_line import run_command
from refusal import assert_refused
from score_files import few_samples, score_results

from freeart21.files.hashes import file_sha256
from leaderboard.board import isolation, secret, workflow
from leaderboard.board.isolation import Request, container_command
from leaderboard.board.ledger import make_key, read_ledger, verify_board
from leaderboard.board.settings import Phase, read_settings, utc_now, write_settings
from leaderboard.board.submissions import find_submissions, open_submission
from leaderboard.board.workflow import check_pull_request, init_board, score_board
from leaderboard.scores_file import read_scores, write_scores

pytestmark = pytest.mark.skipif(
    not all(map(shutil.which, ("git", "ssh-keygen", "openssl"))), reason="needs git, ssh-keygen and openssl"
)
PLACE = Path("submissions/development")
SECRET_NAMES = ("BOARD_TRUTH_KEY", "BOARD_TRUTH_DEVELOPMENT", "BOARD_SIGNING_KEY")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with the data's halves and results folders, and the runner's secrets."""
    base = tmp_path_factory.mktemp("inputs")
    secrets = write_halves(base)
    write_answers(base / "honest", "Honest")
    write_answers(base / "gamed", "gamed", gamed)
    return base, secrets


@pytest.fixture
def board(inputs, tmp_path, monkeypatch):
    """A new board, its secrets in the environment; rows are scored by few samples in this process."""
    base, secrets = inputs
    key = init_board(tmp_path / "board", (str(base / "public.zip"),), "A board")
    for name, value in {**secrets, "BOARD_SIGNING_KEY": key.read_text()}.items():
        monkeypatch.setenv(name, value)
    settings = read_settings(tmp_path / "board")
    write_settings(tmp_path / "board", replace(settings, protocols=("strict-2",), isolation="process"))
    few_samples(monkeypatch)

    def score_here(kind, request, settings):
        scores = score_results(request.results, request.data, request.protocol, truth=request.truth)
        write_scores(request.table, scores)

    monkeypatch.setattr(workflow, "score_in", score_here)
    return tmp_path / "board"


def submit(board: Path, results: Path, method: str, name: str, phase: str = "development") -> Path:
    return zip_results(results, board / "submissions" / phase / method / f"{name}.zip")


def statuses(board: Path) -> dict[str, str]:
    return {f"{e.method}/{e.submission}": e.status for e in read_ledger(board).entries}


def reason(board: Path) -> str:
    (entry,) = (e for e in read_ledger(board).entries if e.status == "refused")
    return entry.reason


def test_three_submissions_from_pull_requests_to_the_published_site(inputs, tmp_path):
    base, secrets = inputs
    host, maintainer = tmp_path / "host.git", tmp_path / "board"
    key = init_board(maintainer, (str(base / "public.zip"),), "A board of made-up objects")
    settings = read_settings(maintainer)
    write_settings(maintainer, replace(settings, protocols=("strict-3",), isolation="process"))
    git(tmp_path, "init", "-q", "--bare", "-b", "main", str(host))
    git(maintainer, "init", "-q", "-b", "main")
    git(maintainer, "remote", "add", "origin", str(host))
    commit(maintainer, "a board")
    git(maintainer, "push", "-q", "origin", "main")
    for method, results in (("honest", base / "honest"), ("gamed", base / "gamed"), ("hostile", None)):
        clone = tmp_path / method
        git(tmp_path, "clone", "-q", str(host), str(clone))
        git(clone, "switch", "-q", "-c", method)
        place = clone / PLACE / method / "first.zip"
        zip_results(results, place) if results else write_traversal(place)
        commit(clone, method)
        faults = check_pull_request(clone, "origin/main")
        assert bool(faults) == (method == "hostile"), faults
        git(clone, "push", "-q", "origin", f"{method}:main")  # a careless maintainer merges all of them
    environment = {k: v for k, v in os.environ.items() if k not in SECRET_NAMES} | secrets
    environment |= {"BOARD_SIGNING_KEY": key.read_text(), "FREEART21": str(write_program(tmp_path / "freeart21"))}
    runner = tmp_path / "runner"
    git(tmp_path, "clone", "-q", str(host), str(runner))
    done = subprocess.run([runner / "run.sh"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "2 scored, 1 refused, 0 waiting" in done.stdout

    anybody, site = tmp_path / "anybody", tmp_path / "site"
    git(tmp_path, "clone", "-q", str(host), str(anybody))
    git(tmp_path, "clone", "-q", "-b", "site", str(host), str(site))
    assert verify_board(anybody, read_settings(anybody)) == []
    assert statuses(anybody) == {"gamed/first": "scored", "honest/first": "scored", "hostile/first": "refused"}
    assert reason(anybody).startswith("submissions/development/hostile/first.zip: entry '../../../run.sh' leads out of")
    assert "run.sh" not in (site / "development/index.html").read_text()
    (history,) = read_ledger(anybody).history
    points = {name: own[0] for name, own in history.tracks["whole"].items()}
    assert points["honest"] > points["gamed"] + 20 and set(points) == {"honest", "gamed"}
    table = read_scores(anybody / "tables/development/honest/first.strict-3.json")
    assert table.benchmark["hidden"] and all(row.values["state"] is None for row in table.rows)
    shown = json.loads((site / "development/site.json").read_text())["files"]
    assert "methods/Honest.html" in shown and "methods/gamed.html" in shown and not any("seq" in f for f in shown[:1])
    everything = b"".join(p.read_bytes() for d in (anybody, site) for p in d.rglob("*") if p.is_file())
    salt = json.loads(_truth_json(inputs))["salt"].encode()
    for word in (PASSPHRASE.encode(), salt, b"OPENSSH PRIVATE KEY"):
        assert word not in everything
    if CHROMIUM:
        with browser() as page:
            for file in ("index.html", "development/index.html", "development/methods/Honest.html"):
                for width in (1280, 390):
                    page.open(site / file, width, 900, ready="true")
                    assert page.run("document.documentElement.scrollWidth") <= width and not page.errors, page.errors
                    if folder := os.environ.get("FREEART21_PICTURES"):
                        Path(folder, f"{file.replace('/', '-')}-{width}.png").write_bytes(page.picture(True))

    done = subprocess.run([runner / "run.sh"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "0 scored, 0 refused, 0 waiting" in done.stdout, done.stderr
    assert git(runner, "rev-list", "--count", "HEAD").strip() == git(anybody, "rev-list", "--count", "HEAD").strip()


def _truth_json(inputs) -> str:
    import zipfile

    with zipfile.ZipFile(inputs[0] / "truth.zip") as archive:
        return archive.read("truth/hidden.json").decode()


def test_a_new_protocol_scores_what_is_there_and_the_newest_submission_counts(board, inputs):
    base, _ = inputs
    submit(board, base / "honest", "honest", "first")
    submit(board, base / "gamed", "gamed", "one")
    assert score_board(board, None).scored == 2
    first = read_ledger(board)
    submit(board, write_answers(board.parent / "worse", "Honest", gamed, seed=1), "honest", "second")
    write_settings(board, replace(read_settings(board), protocols=("strict-2", "strict-1")))
    assert score_board(board, board.parent / "site").scored == 1
    now = read_ledger(board)
    assert now.current("development")["honest"].submission == "second"
    assert sorted(now.current("development")["gamed"].files) == [
        f"tables/development/gamed/one.{protocol}.json{end}"
        for protocol in ("strict-1", "strict-2")
        for end in ("", ".enc")
    ]
    assert len(now.find("development", "honest", "first").files) == 2  # outdated: not scored again
    points = [h.tracks["whole"]["honest"][0] for h in now.history if h.protocol == "strict-2"]
    assert len(points) == 2 and points[1] < points[0] - 10  # the newest one counts, not the best
    assert now.history[: len(first.history)] == first.history and verify_board(board, read_settings(board)) == []
    assert "strict-1" in (board.parent / "site/development/index.html").read_text()


def test_other_scoring_code_scores_everything_again(board, inputs, monkeypatch):
    submit(board, inputs[0] / "honest", "honest", "first")
    monkeypatch.setattr(workflow, "scoring_code", lambda: "0" * 64)
    assert_refused("has another version of freeart21", score_board, board, None)
    assert not (board / "ledger.json").exists()
    monkeypatch.undo()


def test_further_submissions_of_a_week_wait(board, inputs):
    now, reports = utc_now(), []
    for name in "abc":
        submit(board, inputs[0] / "honest", "honest", name)
    assert score_board(board, None, reports.append, now).waiting == 1
    assert any("c waits: 2 of honest" in line for line in reports) and "honest/c" not in statuses(board)
    assert score_board(board, None, now=now + timedelta(days=6)).waiting == 1
    assert score_board(board, None, now=now + timedelta(days=7)).scored == 1
    assert statuses(board)["honest/c"] == "scored"


def test_phases_begin_and_end(board, inputs):
    settings, now = read_settings(board), utc_now()
    phase = replace(settings.phases[0], starts=(now + timedelta(days=2)).date().isoformat())
    ends = (now + timedelta(days=3)).date().isoformat()
    write_settings(board, replace(settings, phases=(replace(phase, ends=ends),)))
    submit(board, inputs[0] / "honest", "honest", "early")
    assert score_board(board, None, now=now).waiting == 1 and not statuses(board)
    assert score_board(board, None, now=now + timedelta(days=2)).scored == 1
    submit(board, inputs[0] / "honest", "honest", "late")
    assert score_board(board, None, now=now + timedelta(days=4)).refused == 1
    assert "the phase ended on" in reason(board)


@pytest.mark.parametrize("name, code, method, line", [
    ("truth", "", "truth", "reserved"),
    ("Gr\u043eund truth", "", "ground-truth", "reserved"),
    ("truth", "freeart21 1, reference row made from the truth", "truth", "made from the truth"),
    ("Other", "", "mine", "expected the name of its folder"),
    ("H0nest", "", "h0nest", "looks like 'honest'"),
])  # fmt: skip
def test_names_that_are_not_ones_own_are_refused(board, inputs, name, code, method, line):
    submit(board, inputs[0] / "honest", "honest", "first")
    score_board(board, None)
    submit(board, write_answers(board.parent / "other", name, code=code), method, "first")
    assert score_board(board, None).refused == 1
    assert line in reason(board)
    assert not list((board / "tables/development").glob(f"{method}/*"))


def test_links_sizes_and_broken_files_are_refused(board, inputs, monkeypatch):
    base, secrets = inputs
    folder = board / PLACE / "linked" / "first"
    folder.mkdir(parents=True)
    (folder / "hinge").symlink_to(base / "secret/truth/hinge")
    (board / PLACE / "gone").mkdir()
    (board / PLACE / "gone" / "first.zip").symlink_to(base / "truth.zip")
    (board / PLACE / "junk").mkdir()
    (board / PLACE / "junk" / "first.zip").write_bytes(b"PK\3\4 nothing")
    submit(board, base / "honest", "honest", "big")
    write_settings(board, replace(read_settings(board), limits=replace(read_settings(board).limits, megabytes=1)))
    (board / PLACE / "honest" / "big.zip").write_bytes(b"0" * 1_100_000)
    score_board(board, None)
    found = {entry.method: entry for entry in read_ledger(board).entries}
    assert "leads out of" in found["gone"].reason or "is a link" in found["gone"].reason
    assert "at most 1 are taken" in found["honest"].reason and "cannot be unpacked" in found["junk"].reason
    if found["linked"].status == "scored":  # a link in a folder costs its row
        table = read_scores(board / "tables/development/linked/first.strict-2.json")
        assert {row.status for row in table.rows} <= {"missing", "unreadable", "invalid", "failed"}
    for path in board.rglob("*"):
        if path.is_file() and not path.is_symlink():
            assert secrets["BOARD_TRUTH_KEY"].encode() not in path.read_bytes()


def test_what_was_received_is_not_exchanged(board, inputs):
    path = submit(board, inputs[0] / "honest", "honest", "first")
    score_board(board, None)
    path.unlink()
    submit(board, inputs[0] / "gamed", "honest", "first")
    before = (board / "ledger.json").read_bytes()
    assert not score_board(board, None).changed and (board / "ledger.json").read_bytes() == before
    reports = []
    write_settings(board, replace(read_settings(board), protocols=("strict-2", "strict-1")))
    score_board(board, None, reports.append)
    assert any("is not what was received" in line for line in reports)


def test_whoever_changes_a_table_or_the_ledger_is_found_out(board, inputs, capsys):
    submit(board, inputs[0] / "honest", "honest", "first")
    score_board(board, None)
    table, ledger = board / "tables/development/honest/first.strict-2.json", board / "ledger.json"
    for path, line in ((table, "is not the table that was signed"), (ledger, "is not signed by board")):
        whole = path.read_bytes()
        path.write_bytes(
            whole.replace(b'"name"', b'"name" ', 1) if path == table else whole.replace(b'"scored"', b'"refused"')
        )
        code, out, _ = run_command(capsys, "board", "verify", board)
        assert code == 1 and line in out
        assert_refused("nothing was scored", score_board, board, None)
        path.write_bytes(whole)
    (board / "tables/development/honest/second.strict-2.json").write_bytes(table.read_bytes())
    assert "is not in the ledger" in verify_board(board, read_settings(board))[0]
    score_board(board, None)  # what a stopped run left is removed
    assert verify_board(board, read_settings(board)) == []
    table.unlink()
    assert "is missing" in verify_board(board, read_settings(board))[0]


def test_only_the_boards_key_signs(board, inputs, monkeypatch, tmp_path):
    submit(board, inputs[0] / "honest", "honest", "first")
    make_key(tmp_path / "another", "board")
    monkeypatch.setenv("BOARD_SIGNING_KEY", str(tmp_path / "another"))
    assert_refused("is not signed by board", score_board, board, None)
    assert not (board / "ledger.json").exists()
    for name in SECRET_NAMES:
        with monkeypatch.context() as patch:
            patch.delenv(name)
            assert_refused(f"{name} is not set", score_board, board, None)


def test_a_wrong_passphrase_or_truth_stops_the_board(board, inputs, monkeypatch):
    submit(board, inputs[0] / "honest", "honest", "first")
    monkeypatch.setenv("BOARD_TRUTH_KEY", "wrong")
    assert_refused("", score_board, board, None)
    monkeypatch.setenv("BOARD_TRUTH_DEVELOPMENT", "no such.zip")
    assert_refused("BOARD_TRUTH_DEVELOPMENT: no such.zip is not there", score_board, board, None)
    shutil.copytree(inputs[0] / "secret", board / "public")
    monkeypatch.setenv("BOARD_TRUTH_DEVELOPMENT", "public")
    assert_refused("", score_board, board, None)
    assert not statuses(board)


def test_a_pull_request_adds_one_methods_submissions_and_nothing_else(board, inputs):
    git(board, "init", "-q", "-b", "main")
    submit(board, inputs[0] / "honest", "honest", "first")
    commit(board, "a board")
    git(board, "switch", "-q", "-c", "branch")

    def faults(change) -> list[str]:
        change()
        commit(board, "change")
        found = check_pull_request(board, "main")
        git(board, "reset", "-q", "--hard", "main")
        return found

    assert faults(lambda: submit(board, inputs[0] / "gamed", "gamed", "first")) == []
    assert "board.json is changed" in faults(lambda: write_settings(board, replace(read_settings(board), title="x")))[0]
    assert "expected a new name" in faults(lambda: (board / PLACE / "honest/first.zip").unlink())[0]
    assert (
        "of 2 methods" in faults(lambda: [submit(board, inputs[0] / "gamed", m, "first") for m in ("gamed", "game")])[0]
    )
    assert "looks like 'honest'" in faults(lambda: submit(board, inputs[0] / "honest", "Honest-", "first"))[0]
    assert (
        "the phase is not open; open: development"
        in faults(lambda: submit(board, inputs[0] / "gamed", "gamed", "a", "test"))[0]
    )
    broken = write_answers(board.parent / "broken", "broken")
    (broken / SEQUENCES[0] / "prediction.json").write_text("{")
    assert "hinge" in faults(lambda: submit(board, broken, "broken", "first"))[0]


def test_a_submission_can_be_an_address(board, inputs, monkeypatch, tmp_path):
    archive = zip_results(inputs[0] / "honest", tmp_path / "there.zip")
    place = board / PLACE / "honest" / "first.json"
    place.parent.mkdir()
    entry = {"schema": "freeart21/board-submission/1", "url": archive.as_uri(), "sha256": file_sha256(archive)}
    (given,) = _written(board, place, entry)
    (tmp_path / "work").mkdir()

    def opened():
        with open_submission(given, board, read_settings(board), tmp_path / "work") as (folder, digest):
            return (folder / "method.json").read_text(), digest

    assert_refused("does not begin with https", opened)
    monkeypatch.setattr(secret, "SCHEMES", ("file://",))
    assert "Honest" in opened()[0]
    (tmp_path / "work" / "first.zip").unlink()
    _written(board, place, {**entry, "sha256": "0" * 64})
    assert_refused("is not the file of its 'sha256'", opened)


def _written(board: Path, place: Path, entry: dict[str, str]):
    place.write_text(json.dumps(entry))
    return find_submissions(board)


def test_a_container_has_no_network_and_writes_the_table_only(inputs, tmp_path, monkeypatch):
    """A stand-in for docker: it runs the words behind the image here, with the mounted folders' own paths."""
    base, _ = inputs
    log = tmp_path / "log"
    docker = tmp_path / "docker"
    docker.write_text(
        f"#!{sys.executable}\nimport json, subprocess, sys\nwords = sys.argv[1:]\n"
        "if words == ['info']: sys.exit(0)\n"
        f"open({str(log)!r}, 'w').write(json.dumps(words))\n"
        "mounts = [w.rsplit(':', 2) for k, w in enumerate(words) if words[k - 1] == '--volume']\n"
        "there = {m[1]: m[0] for m in mounts}\n"
        "place = lambda w: next((w.replace(a, b, 1) for a, b in there.items() if w == a or w.startswith(a + '/')), w)\n"
        f"program = {str(write_program(tmp_path / 'freeart21'))!r}\n"
        "command = [program, *map(place, words[words.index('freeart21') + 1 :])]\n"
        "sys.exit(subprocess.run(command).returncode)\n"
    )
    docker.chmod(docker.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("BOARD_TRUTH_KEY", PASSPHRASE)
    isolation._runs.cache_clear()
    init_board(tmp_path / "board", ("nowhere",))
    settings = read_settings(tmp_path / "board")
    assert isolation.choose_isolation(settings) == "docker"
    isolation._runs.cache_clear()
    (tmp_path / "out").mkdir()
    request = Request(base / "honest", base / "secret", None, "arena-1", tmp_path / "out" / "table.json")
    isolation.score_in("docker", request, settings)
    assert read_scores(request.table).protocol == "arena-1"
    words = json.loads(log.read_text())
    assert words[words.index("--network") + 1] == "none" and "--read-only" in words and PASSPHRASE not in str(words)
    assert [w for w in words if w.endswith(":rw")] == [f"{tmp_path / 'out'}:/out:rw"]
    hidden = container_command("podman", "name", replace(request, truth=base), settings)
    assert f"{base}:/truth:ro" in hidden and hidden[hidden.index("--truth") + 1] == "/truth"


def test_scoring_gets_no_secret_and_ends_in_time(tmp_path, inputs, monkeypatch):
    monkeypatch.setenv("BOARD_TRUTH_KEY", PASSPHRASE)
    spy = "import os, sys\nopen(sys.argv[sys.argv.index('--out') + 1], 'w').write(str(dict(os.environ)))"
    monkeypatch.setattr(isolation, "_PROGRAM", spy)
    init_board(tmp_path / "board", ("nowhere",))
    settings = read_settings(tmp_path / "board")
    request = Request(tmp_path, tmp_path, None, "strict-2", tmp_path / "seen")
    isolation.score_in("process", request, settings)
    assert "PATH" in request.table.read_text() and PASSPHRASE not in request.table.read_text()
    monkeypatch.setattr(isolation, "_PROGRAM", "import time\ntime.sleep(60)")
    short = replace(settings, limits=replace(settings.limits, minutes=0.02))
    late = replace(request, table=tmp_path / "late")
    assert_refused("took more than 0.02 minutes", isolation.score_in, "process", late, short)
    monkeypatch.setattr(isolation, "_PROGRAM", "import sys\nsys.exit('freeart21: nothing there')")
    assert_refused("without a table: freeart21: nothing there", isolation.score_in, "process", late, settings)


def test_a_process_without_network_reaches_nothing(tmp_path, monkeypatch):
    settings_kind = "process without network"
    if not isolation._runs((*isolation._WITHOUT_NETWORK, "true")):
        pytest.skip("this kernel gives no network namespace")
    names = "str([name for _, name in socket.if_nameindex()])"
    net = f"import socket, sys\nopen(sys.argv[sys.argv.index('--out') + 1], 'w').write({names})"
    monkeypatch.setattr(isolation, "_PROGRAM", net)
    init_board(tmp_path / "board", ("nowhere",))
    request = Request(tmp_path, tmp_path, None, "strict-2", tmp_path / "seen")
    isolation.score_in(settings_kind, request, read_settings(tmp_path / "board"))
    assert request.table.read_text() == "['lo']"


def test_a_board_is_written_once_and_its_settings_are_checked(tmp_path, capsys):
    code, out, _ = run_command(
        capsys, "board", "init", tmp_path / "board", "--data", "public.zip", "https://x.org/t.zip"
    )
    assert code == 0 and "board.key" in out and (tmp_path / "board.key").stat().st_mode & 0o777 == 0o600
    assert (tmp_path / "board/run.sh").stat().st_mode & 0o111
    written = "".join(p.read_text() for p in (tmp_path / "board").rglob("*") if p.is_file())
    assert not re.findall(r"@[A-Z_]+@", written)
    assert (
        "BOARD_TRUTH_TEST: ${{ secrets.BOARD_TRUTH_TEST }}"
        in (tmp_path / "board/.github/workflows/board.yml").read_text()
    )
    assert_refused("exists", init_board, tmp_path / "board", ("public.zip",))
    (tmp_path / "board.key").unlink()
    assert_refused("exists", init_board, tmp_path / "board", ("public.zip",))
    assert_refused("expected one a phase", init_board, tmp_path / "more", ("a", "b", "c"))
    settings = read_settings(tmp_path / "board")
    development, test = settings.phases
    assert development.ends < test.starts and test.ends is None
    for change, line in (
        ({"phases": (replace(test, starts="2026-13-01"),)}, "expected one such as 2026-12-01"),
        (
            {"phases": (test, Phase("te-st", "a", "2026-01-01", None), Phase("te.st", "a", "2026-01-01", None))},
            "one variable",
        ),
        ({"phases": ()}, "has no phases"),
        ({"protocols": ("strict-9",)}, "strict-9"),
        ({"limits": replace(settings.limits, per_week=0)}, "'per_week' is below 1"),
    ):
        write_settings(tmp_path / "board", replace(settings, **change))
        assert_refused(line, read_settings, tmp_path / "board")
    assert_refused("is not a board", read_settings, tmp_path)
