"""The process in which an asset is looked through, or tried in one engine: what crashes or hangs there ends it alone.

It reads one request from standard input and writes a line of JSON for each rule that it begins and each row that it
has, each after a mark, whatever native code prints in between.
"""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from export.check.report import Row, Verdict
from export.check.rules import ENGINE_RULES, FILE_RULES
from freeart21 import child
from freeart21.errors import FreeArtError

MARK = "freeart21-check:"
_MEMORY = 12 << 30
"""Bytes of address space that a trial may take."""
WALL = 3
"""Times the processor time allowed that may go by: what is left of a core that two others use, too."""
_LONGEST_OUTPUT = 4 << 20
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Answer:
    """What a process found."""

    rows: tuple[Row, ...]
    facts: dict[str, Any]
    """What the file stage found out, and the engine's version."""
    seconds: float


def ask(request: dict[str, Any], limit_s: float) -> Answer:
    """The rows of one stage, asked in a process of its own; a rule at which it crashed has failed, one at which it took
    more than `limit_s` of processor time, or `WALL` times that by the clock, is unknown."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as place, tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            child.command("export.check.trial_process"),
            stdin=subprocess.PIPE,
            stdout=said,
            stderr=errors,
            env={**os.environ, **dict.fromkeys(_THREADS, "1"), "TMPDIR": place},
        )
        end = ""
        verdict: Verdict = "fail"
        try:
            process.communicate(json.dumps({**request, "cpu_s": limit_s}).encode(), timeout=WALL * limit_s)
        except subprocess.TimeoutExpired:
            end, verdict = f"it took more than {WALL * limit_s:g} s", "unknown"
        finally:
            process.kill()
            process.wait()
        said.seek(0)
        lines = said.read(_LONGEST_OUTPUT).decode(errors="replace").splitlines()
        errors.seek(0)
        last = (errors.read(_LONGEST_OUTPUT).decode(errors="replace").strip().splitlines() or [""])[-1][:200]
    if process.returncode == -signal.SIGXCPU:
        end, verdict = f"it took more than {limit_s:g} s of processor time", "unknown"
    if not end and process.returncode != 0:
        how = f"signal {-process.returncode}" if process.returncode < 0 else f"exit code {process.returncode}"
        end = f"it ended the engine ({how}){': ' + last if last else ''}"
    return _understood(request["engine"], lines, end, verdict, time.monotonic() - began)


def _understood(engine: str, lines: list[str], end: str, verdict: Verdict, seconds: float) -> Answer:
    rows: list[Row] = []
    facts: dict[str, Any] = {}
    trying = ""
    for line in lines:
        if line.startswith(MARK):
            told = json.loads(line[len(MARK) :])
            trying = told.get("trying", trying)
            facts |= told.get("facts", {})
            if "row" in told:
                rows.append(Row(**told["row"]))
    if end:
        rules = {"file": list(FILE_RULES), "simcheck": ["simcheck.finished"]}.get(engine, list(ENGINE_RULES))
        done = {row.rule for row in rows}
        failed = trying or rules[0]
        rows.append(Row(failed, engine, verdict, end))
        left: Verdict = "unknown" if verdict == "unknown" else "skip"
        rows += [Row(r, engine, left, "not reached") for r in rules if r not in done and r != failed]
    return Answer(tuple(rows), facts, seconds)


# ---- in the process


def main() -> None:
    """Answer the request on standard input."""
    request = json.loads(sys.stdin.read())
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    cpu_s = max(1, math.ceil(request["cpu_s"]))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    try:
        for row in _rows(request):
            _tell(row=asdict(row))
    except Exception as error:  # hostile files reach parsers of many libraries
        sys.exit(child.one_line(error))


def _tell(**what: object) -> None:
    print(f"\n{MARK}{json.dumps(what)}", flush=True)


def _rows(request: dict[str, Any]) -> Iterator[Row]:
    engine, folder = request["engine"], Path(request["folder"])
    urdf, mjcf = (Path(request[key]) if request.get(key) else None for key in ("urdf", "mjcf"))
    if engine == "file":
        from export.check.file_rules import file_rows

        facts: dict[str, Any] = {}
        yield from file_rows(urdf, mjcf, folder, facts, lambda rule: _tell(trying=rule, facts=facts))
        _tell(facts=facts)
        return
    if engine == "simcheck":
        from export.check.simcheck_rules import simcheck_rows

        file = urdf or mjcf
        assert file is not None
        yield from simcheck_rows(file, float(request["limit_s"]))
        _tell(facts={"version": metadata.version("simcheck")})
        return
    from export.check.engines.base import load_world
    from export.check.tree import hold_followers
    from export.check.trial import Trial

    _tell(facts={"version": metadata.version(engine)})
    file = mjcf if engine == "mujoco" and mjcf is not None else urdf
    if file is None:
        for rule in ENGINE_RULES:
            yield Row(rule, engine, "skip", "it is tried with URDFs alone")
        return
    tree = _tree(urdf, mjcf)
    if tree is not None and file == urdf:
        tree = hold_followers(tree)
    trial = Trial(engine, tree, request.get("lowest"), partial(load_world, engine, file, folder))
    yield from trial.rows(lambda rule: _tell(trying=rule))


def _tree(urdf: Path | None, mjcf: Path | None) -> Any:
    from export.check.mjcf_tree import NotRead, tree_of_mjcf
    from export.check.tree import tree_of_urdf
    from freeart21.files.urdf import read_urdf

    if urdf is not None:
        return tree_of_urdf(read_urdf(urdf))
    assert mjcf is not None
    try:
        return tree_of_mjcf(mjcf)
    except (NotRead, FreeArtError):
        return None
