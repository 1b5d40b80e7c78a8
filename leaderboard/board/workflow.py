"""The steps of a board: write its repository, check a pull request, score what is new, sign, and build the site."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from importlib import resources
from pathlib import Path

import freeart21
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.hashes import file_sha256
from leaderboard.board import ledger as ledgers
from leaderboard.board.isolation import Kind, Request, choose_isolation, score_in
from leaderboard.board.ledger import Entry, Ledger, Places, make_key, read_ledger, verify_board, write_ledger
from leaderboard.board.pages import write_front_page
from leaderboard.board.secret import ENCRYPTED, crypt, open_place
from leaderboard.board.settings import (
    DATA,
    TRUTH,
    TRUTH_KEY,
    BoardSettings,
    Limits,
    Phase,
    read_settings,
    utc_now,
    write_settings,
)
from leaderboard.board.submissions import (
    FOLDER,
    Submission,
    check_folder,
    check_method,
    count_of_week,
    find_submissions,
    open_submission,
)
from leaderboard.points import TRACKS, standings
from leaderboard.protocols import protocol_named
from leaderboard.provenance import scoring_code
from leaderboard.rows import Scores
from leaderboard.score import benchmark_facts
from leaderboard.scores_file import read_scores, write_scores
from leaderboard.site.build import write_site
from leaderboard.site.entrant import public_scores
from leaderboard.validate import validate_results

PROTOCOLS = ("strict-3",)
PHASES = ("development", "test")
_DEVELOPMENT = timedelta(days=90)
_TEMPLATE = {
    "README.md": "README.md",
    "run.sh": "run.sh",
    "Dockerfile": "Dockerfile",
    "board.yml": ".github/workflows/board.yml",
    "gitignore": ".gitignore",
}
"""File in `template/` to its place in a board."""
Report = Callable[[str], None]


def init_board(folder: Path, data: tuple[str, ...], title: str = "", package: str = "") -> Path:
    """Write the repository of a new board to the new folder `folder`; gives the private key's file, next to it.

    Args:
        folder: Where nothing is yet.
        data: The public half of each phase: paths relative to the board, or https addresses of ZIPs. One: a phase
            without end. Two: 90 days of development, and the test after it.
        title: Of the board.
        package: What pip installs, when it is not this version of freeart21.
    """
    folder = Path(folder)
    key = folder.absolute().parent / f"{folder.name}.key"
    if not 1 <= len(data) <= len(PHASES):
        raise FreeArtError(f"board init: got {len(data)} data folders, expected one a phase: {' and '.join(PHASES)}")
    if key.exists():
        raise FreeArtError(f"{key} exists; it would be this board's signing key: move it, or choose another place")
    start, signer = utc_now().date(), "board"
    turn = start + _DEVELOPMENT
    phases = [Phase(PHASES[0], data[0], start.isoformat(), None if len(data) == 1 else turn.isoformat())]
    if len(data) > 1:
        phases.append(Phase(PHASES[1], data[1], (turn + timedelta(days=1)).isoformat(), None))
    name = title or folder.name
    limits = Limits(per_week=2, megabytes=1000, minutes=120, memory_gib=12)
    settings = BoardSettings(name, PROTOCOLS, tuple(phases), limits, "auto", "freeart21-board", signer)
    secrets = "\n".join(f"          {p.variable(TRUTH)}: ${{{{ secrets.{p.variable(TRUTH)} }}}}" for p in phases)
    words = {
        "@TITLE@": name,
        "@PACKAGE@": package or f"freeart21=={freeart21.__version__}",
        "@SECRETS@": secrets.lstrip(),
        "@PHASES@": ", ".join(f"`{p.name}`" for p in phases),
        "@PER_WEEK@": f"{limits.per_week} submission{'s' * (limits.per_week > 1)}",
        "@MEGABYTES@": str(limits.megabytes),
    }
    with atomic.new_folder(folder) as new:
        template = resources.files("leaderboard.board").joinpath("template")
        for source, place in _TEMPLATE.items():
            text = template.joinpath(source).read_text("utf-8")
            for word, value in words.items():
                text = text.replace(word, value)
            atomic.write_bytes(new / place, text.encode(), mode=0o755 if place.endswith(".sh") else 0o644)
        write_settings(new, settings)
        for phase in phases:
            atomic.write_bytes(new / FOLDER / phase.name / ".keep", b"")
        atomic.write_bytes(new / ledgers.SIGNERS, make_key(key, signer).encode())
    return key


class BrokenBoard(FreeArtError):
    """Scoring failed, and not by the submission's fault."""


@dataclass(frozen=True)
class Outcome:
    """What a run of `score_board` did."""

    scored: int
    refused: int
    waiting: int
    changed: bool
    """Whether the ledger is another one than before."""


def score_board(folder: Path, site: Path | None, report: Report = print, now: datetime | None = None) -> Outcome:
    """Score every new submission, and current ones by protocols and code that their tables lack; sign; build the site.

    Tables are written before the ledger that lists them. `site` is a folder outside of the board. Raises FreeArtError
    when the board itself is broken: its signature, a secret, a data folder.
    """
    folder, now = Path(folder).resolve(), now or utc_now()
    settings = read_settings(folder)
    before = ledger = read_ledger(folder)
    listed = {name for entry in ledger.entries for name in entry.files}
    for path in sorted((folder / "tables").rglob("*.json*")):
        if path.relative_to(folder).as_posix() not in listed:
            path.unlink()  # of a run that was stopped before it signed
    faults = verify_board(folder, settings)
    if faults:
        raise FreeArtError(f"{faults[0]}{f' (and {len(faults) - 1} more)' * (len(faults) > 1)}; nothing was scored")
    ledgers.require_signing_key()
    kind = choose_isolation(settings)
    counts = {"scored": 0, "refused": 0, "waiting": 0}
    tables: dict[str, dict[str, dict[str, Scores]]] = {}
    for phase in settings.phases:
        given = [one for one in find_submissions(folder) if one.phase == phase.name]
        if not given and not ledger.current(phase.name):
            continue
        with _open_phase(phase, folder) as (data, truth), tempfile.TemporaryDirectory(prefix="freeart21-") as work:
            judge = _Judge(folder, settings, phase, data, truth, kind, Path(work), report)
            for one in given:
                ledger = judge.receive(one, ledger, now, counts)
            for entry in list(ledger.current(phase.name).values()):
                ledger = judge.rescore(entry, given, ledger)
            tables[phase.name] = judge.read_tables(ledger)
        ledger = _with_places(ledger, phase.name, tables[phase.name], settings, now)
    if ledger != before:
        write_ledger(folder, ledger, settings)
    if site is not None:
        _write_sites(site, settings, ledger, tables)
    return Outcome(**counts, changed=ledger != before)


@contextlib.contextmanager
def _open_phase(phase: Phase, folder: Path) -> Iterator[tuple[Benchmark, Path | None]]:
    """The data folder of a phase, and its truth when that is hidden; gone when the block ends."""
    with contextlib.ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="freeart21-")))
        (work / "data").mkdir()
        (work / "truth").mkdir()
        where = os.environ.get(phase.variable(DATA), "") or phase.data
        data = stack.enter_context(open_place(where, folder, work / "data", f"data of {phase.name}"))
        benchmark = read_benchmark(data)
        if not benchmark.hidden:
            yield benchmark, None
            return
        name = phase.variable(TRUTH)
        if not os.environ.get(TRUTH_KEY):
            raise FreeArtError(f"{TRUTH_KEY} is not set, expected the passphrase of truths and whole tables")
        if not os.environ.get(name):
            raise FreeArtError(f"{name} is not set, expected the place of the hidden truth of {phase.name}")
        truth = stack.enter_context(open_place(os.environ[name], folder, work / "truth", name))
        if folder.resolve() in truth.resolve().parents:
            raise FreeArtError(f"{name}: the hidden truth lies in the board, whose files are public")
        yield read_benchmark(data, truth), truth


@dataclass(frozen=True)
class _Judge:
    """Scores the submissions of one phase."""

    board: Path
    settings: BoardSettings
    phase: Phase
    benchmark: Benchmark
    truth: Path | None
    kind: Kind
    work: Path
    report: Report

    def receive(self, given: Submission, ledger: Ledger, now: datetime, counts: dict[str, int]) -> Ledger:
        """The ledger with a submission's entry; as it was when that is there already, or has to wait."""
        limit, early = self.settings.limits.per_week, now.date().isoformat() < self.phase.starts
        if ledger.find(given.phase, given.method, given.name):
            return ledger
        if early or (self.phase.is_open(now) and count_of_week(ledger, given, now) >= limit):
            counts["waiting"] += 1
            begins = f"the phase begins on {self.phase.starts}"
            quota = f"{limit} of {given.method} were received within a week"
            self.report(f"{given.place} waits: {begins if early else quota}")
            return ledger
        entry = Entry(given.phase, given.method, given.name, "", now.isoformat(), "scored", "", self.kind, {})
        try:
            if not self.phase.is_open(now):
                raise FreeArtError(f"{given.place}: the phase ended on {self.phase.ends}")
            check_folder(given, {e.method for e in ledger.entries if e.status == "scored"})
            entry = self._score(given, entry, self.settings.protocols)
        except BrokenBoard:
            raise
        except FreeArtError as error:
            entry = replace(entry, status="refused", reason=str(error).replace(f"{self.board}/", ""), files={})
        counts[entry.status] += 1
        self.report(f"{given.place}: {entry.status}{f': {entry.reason}' if entry.reason else f' in a {self.kind}'}")
        return ledger.with_entry(entry)

    def rescore(self, entry: Entry, given: list[Submission], ledger: Ledger) -> Ledger:
        """The ledger, where a current submission has tables by all protocols and by this code."""
        missing = [p for p in self.settings.protocols if not self._is_current(entry, p)]
        if not missing:
            return ledger
        own = [one for one in given if (one.method, one.name) == (entry.method, entry.submission)]
        place = f"{FOLDER}/{entry.phase}/{entry.method}/{entry.submission}"
        try:
            if not own:
                raise FreeArtError(f"{place} is gone")
            changed = self._score(own[0], entry, missing)
        except BrokenBoard:
            raise
        except FreeArtError as error:
            self.report(f"{place} cannot be scored again by {', '.join(missing)}: {error}")
            return ledger
        self.report(f"{place}: scored by {', '.join(missing)}")
        return ledger.with_entry(changed)

    def read_tables(self, ledger: Ledger) -> dict[str, dict[str, Scores]]:
        """Protocol to method's folder to the complete table of its current submission, by this code."""
        found: dict[str, dict[str, Scores]] = {}
        for entry in ledger.current(self.phase.name).values():
            if all(self._is_current(entry, protocol) for protocol in self.settings.protocols):
                for protocol in self.settings.protocols:
                    found.setdefault(protocol, {})[entry.method] = self._read_whole(entry, protocol)
        return found

    def _is_current(self, entry: Entry, protocol: str) -> bool:
        path = self._table(entry, protocol)
        if path.relative_to(self.board).as_posix() not in entry.files:
            return False
        table = read_scores(path)
        facts = {key: value for key, value in table.benchmark.items() if key != "hidden"}
        own = {key: value for key, value in benchmark_facts(self.benchmark).items() if key != "hidden"}
        return table.made_with.get("scoring") == scoring_code() and facts == own

    def _score(self, given: Submission, entry: Entry, protocols: tuple[str, ...] | list[str]) -> Entry:
        """The entry with tables by these protocols; nothing is written unless all of them can be."""
        found: dict[str, Scores] = {}
        with (
            tempfile.TemporaryDirectory(dir=self.work) as aside,
            open_submission(given, self.board, self.settings, Path(aside)) as (results, digest),
        ):
            if entry.sha256 and entry.sha256 != digest:
                raise FreeArtError(f"{given.place} is not what was received: a new one needs a new name")
            for protocol in protocols:
                path = Path(aside) / "out" / "table.json"
                path.parent.mkdir(exist_ok=True)
                path.unlink(missing_ok=True)
                score_in(self.kind, Request(results, self.benchmark.folder, self.truth, protocol, path), self.settings)
                found[protocol] = self._checked_table(given, path, protocol)
        files = dict(entry.files)
        for protocol, table in found.items():
            for place in self._write_table(entry, protocol, table):
                files[place.relative_to(self.board).as_posix()] = file_sha256(place)
        return replace(entry, sha256=digest, isolation=self.kind, files=dict(sorted(files.items())))

    def _checked_table(self, given: Submission, path: Path, protocol: str) -> Scores:
        """The table that scoring wrote. Raises FreeArtError where it is of something else than was asked."""
        table = read_scores(path)
        if table.made_with.get("scoring") != scoring_code():
            raise BrokenBoard(f"the image {self.settings.image} has another version of freeart21: build it again")
        if table.protocol != protocol or table.benchmark != benchmark_facts(self.benchmark):
            raise BrokenBoard(f"{given.place}: its table is of another protocol or benchmark")
        check_method(given, table.method)
        return table

    def _table(self, entry: Entry, protocol: str) -> Path:
        return self.board / "tables" / entry.phase / entry.method / f"{entry.submission}.{protocol}.json"

    def _write_table(self, entry: Entry, protocol: str, table: Scores) -> list[Path]:
        """Write what may be public of a table and, where the truth is hidden, the whole one encrypted."""
        path = self._table(entry, protocol)
        write_scores(path, public_scores(table, self.benchmark.hidden))
        if not self.benchmark.hidden:
            return [path]
        with tempfile.TemporaryDirectory(dir=self.work) as aside:
            whole, sealed = Path(aside) / path.name, Path(aside) / f"{path.name}{ENCRYPTED}"
            write_scores(whole, table)
            crypt(whole, sealed)
            atomic.write_bytes(path.with_name(sealed.name), sealed.read_bytes())
        return [path, path.with_name(f"{path.name}{ENCRYPTED}")]

    def _read_whole(self, entry: Entry, protocol: str) -> Scores:
        path = self._table(entry, protocol)
        if not self.benchmark.hidden:
            return read_scores(path)
        with tempfile.TemporaryDirectory(dir=self.work) as aside:
            crypt(path.with_name(f"{path.name}{ENCRYPTED}"), Path(aside) / path.name, decrypt=True)
            return read_scores(Path(aside) / path.name)


def _with_places(
    ledger: Ledger, phase: str, tables: dict[str, dict[str, Scores]], settings: BoardSettings, now: datetime
) -> Ledger:
    """The ledger with the places of a phase, where these are others than before."""
    for protocol in settings.protocols:
        rules = protocol_named(protocol)
        tracks: dict[str, dict[str, tuple[float | None, ...]]] = {}
        for track in TRACKS:
            found = standings(tables.get(protocol, {}), track, rules)
            tracks[track] = {name: (round(own.points, 6), own.place) for name, own in sorted(found.items())}
        last = next((h for h in reversed(ledger.history) if (h.phase, h.protocol) == (phase, protocol)), None)
        if any(tracks.values()) and (last is None or last.tracks != tracks):
            ledger = replace(ledger, history=(*ledger.history, Places(now.isoformat(), phase, protocol, tracks)))
    return ledger


def _write_sites(
    site: Path, settings: BoardSettings, ledger: Ledger, tables: dict[str, dict[str, dict[str, Scores]]]
) -> None:
    """A site of each phase, from tables alone, and the front page with phases, submissions and the history."""
    shown = []
    for phase in settings.phases:
        methods = tables.get(phase.name) or {}
        if not methods:
            continue
        with tempfile.TemporaryDirectory(prefix="freeart21-") as work:
            places = []
            for protocol, of in methods.items():
                for method, table in of.items():
                    places.append(Path(work) / f"{method}.{protocol}.json")
                    write_scores(places[-1], table)
            title = f"{settings.title}: {phase.name}"
            command = ("freeart21", "board", "score")
            write_site(places, None, site / phase.name, settings.protocols, title=title, command=command)
        shown.append(phase.name)
    write_front_page(site / "index.html", settings, ledger, shown)


def check_pull_request(folder: Path, base: str) -> list[str]:
    """What speaks against merging the checked out branch into `base`: a line each, empty when nothing.

    Needs no secret. It may add submissions of one method to open phases, and change nothing else; each is validated
    where the data folder can be had.
    """
    folder = Path(folder)
    settings, now, faults = read_settings(folder), utc_now(), []
    added, others = set(), set()
    for status, name in _changed_files(folder, base):
        parts = Path(name).parts
        if parts[0] != FOLDER or len(parts) < 4:
            faults.append(f"{name} is changed, expected nothing but {FOLDER}/PHASE/METHOD/NAME")
        elif status != "A":
            faults.append(f"{name} is changed or removed, expected a new name for a new submission")
        else:
            added.add((parts[1], parts[2], parts[3]))
    if len({method for _, method, _ in added}) > 1:
        faults.append(f"it has submissions of {len({m for _, m, _ in added})} methods, expected one a pull request")
    found = {(one.phase, one.method, one.path.name): one for one in find_submissions(folder)}
    others = {one.method for key, one in found.items() if key not in added}
    for key in sorted(added):
        place = "/".join((FOLDER, *key))
        given, phase = found.get(key), settings.phase(key[0])
        if given is None:
            faults.append(f"{place} is no submission, expected a folder, a .zip or a .json with a plain name")
        elif phase is None or not phase.is_open(now):
            faults.append(f"{place}: the phase is not open; open: {', '.join(_open_phases(settings, now)) or 'none'}")
        else:
            try:
                check_folder(given, others)
                faults += _validate(given, phase, folder, settings)
            except FreeArtError as error:
                faults.append(str(error))
    return faults


def _open_phases(settings: BoardSettings, now: datetime) -> list[str]:
    return [phase.name for phase in settings.phases if phase.is_open(now)]


def _validate(given: Submission, phase: Phase, folder: Path, settings: BoardSettings) -> list[str]:
    from freeart21.files.result import read_method

    with contextlib.ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="freeart21-")))
        for name in ("data", "results"):
            (work / name).mkdir()
        where = os.environ.get(phase.variable(DATA), "") or phase.data
        data = stack.enter_context(open_place(where, folder, work / "data", f"data of {phase.name}"))
        results, _ = stack.enter_context(open_submission(given, folder, settings, work / "results"))
        check_method(given, read_method(results))
        return [f"{given.place}: {fault}" for fault in validate_results(results, data).faults]


def _changed_files(folder: Path, base: str) -> list[tuple[str, str]]:
    """Status (A, M, D, ...) and name of every file that differs from where the branch left `base`."""
    command = ["git", "-C", str(folder), "diff", "--name-status", "--no-renames", "-z", f"{base}...HEAD", "--"]
    done = subprocess.run(command, capture_output=True, timeout=600)
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise FreeArtError(f"{folder}: git cannot compare it with {base}: {lines[0] if lines else ''}")
    words = done.stdout.decode("utf-8", "replace").split("\0")
    return list(zip(words[0::2], words[1::2], strict=False))
