"""The process that judges the files or runs one engine, so that a crash or hang ends only this stage.

It reads one request from standard input. For each rule that it begins, and each row, it writes a marked line of JSON,
as native code prints in between.
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
from freeart21 import processes
from freeart21.errors import FreeArtError

LINE_MARK = "freeart21-check:"
_MEMORY = 12 << 30
"""Bytes of address space of a trial."""
WALL = 3
"""Wall time allowed over the processor time allowed: a core can be shared with two others."""
_LONGEST_OUTPUT = 4 << 20
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class StageResult:
    """What a process found."""

    rows: tuple[Row, ...]
    facts: dict[str, Any]
    """Facts from the file stage, and the engine's version."""
    seconds: float


def run_stage(request: dict[str, Any], limit_s: float) -> StageResult:
    """The rows of one stage, judged in a process of its own.

    A rule at which it crashed has failed. A rule at which it exceeded `limit_s` of processor time, or `WALL` times that
    by the clock, is unknown.
    """
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as place, tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        end, code = "", 0
        verdict: Verdict = "fail"
        try:
            code = subprocess.run(
                processes.command("export.check.trial_process"),
                input=json.dumps({**request, "cpu_s": limit_s}).encode(),
                stdout=output,
                stderr=errors,
                env={**os.environ, **dict.fromkeys(_THREADS, "1"), "TMPDIR": place},
                timeout=WALL * limit_s,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            end, verdict = f"it took more than {WALL * limit_s:g} s", "unknown"
        output.seek(0)
        lines = output.read(_LONGEST_OUTPUT).decode(errors="replace").splitlines()
        errors.seek(0)
        last = (errors.read(_LONGEST_OUTPUT).decode(errors="replace").strip().splitlines() or [""])[-1][:200]
    if code == -signal.SIGXCPU:
        end, verdict = f"it took more than {limit_s:g} s of processor time", "unknown"
    if not end and code != 0:
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        end = f"it ended the engine ({how}){': ' + last if last else ''}"
    return _parse_output(request["engine"], lines, end, verdict, time.monotonic() - began)


def _parse_output(engine: str, lines: list[str], end: str, verdict: Verdict, seconds: float) -> StageResult:
    rows: list[Row] = []
    facts: dict[str, Any] = {}
    trying = ""
    for line in lines:
        if line.startswith(LINE_MARK):
            message = json.loads(line[len(LINE_MARK) :])
            trying = message.get("trying", trying)
            facts |= message.get("facts", {})
            if "row" in message:
                rows.append(Row(**message["row"]))
    if end:
        rules = {"file": list(FILE_RULES), "simcheck": ["simcheck.finished"]}.get(engine, list(ENGINE_RULES))
        done = {row.rule for row in rows}
        failed = trying or rules[0]
        rows.append(Row(failed, engine, verdict, end))
        rest: Verdict = "unknown" if verdict == "unknown" else "skip"
        rows += [Row(r, engine, rest, "not reached") for r in rules if r not in done and r != failed]
    return StageResult(tuple(rows), facts, seconds)


# ---- in the process


def main() -> None:
    """Answer the request on standard input."""
    request = json.loads(sys.stdin.read())
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    cpu_s = max(1, math.ceil(request["cpu_s"]))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    try:
        for row in _judge_stage(request):
            _emit(row=asdict(row))
    except Exception as error:  # hostile files reach parsers of many libraries
        sys.exit(processes.one_line(error))


def _emit(**what: object) -> None:
    print(f"\n{LINE_MARK}{json.dumps(what)}", flush=True)


def _judge_stage(request: dict[str, Any]) -> Iterator[Row]:
    engine, folder = request["engine"], Path(request["folder"])
    urdf, mjcf = (Path(request[key]) if request.get(key) else None for key in ("urdf", "mjcf"))
    if engine == "file":
        from export.check.file_rules import judge_files

        facts: dict[str, Any] = {}
        yield from judge_files(urdf, mjcf, folder, facts, lambda rule: _emit(trying=rule, facts=facts))
        _emit(facts=facts)
        return
    if engine == "simcheck":
        from export.check.simcheck_rules import run_simcheck

        file = urdf or mjcf
        assert file is not None
        yield from run_simcheck(file, float(request["limit_s"]))
        _emit(facts={"version": metadata.version("simcheck")})
        return
    from export.check.engines.base import load_world
    from export.check.tree import freeze_mimics
    from export.check.trial import Trial

    _emit(facts={"version": metadata.version(engine)})
    file = mjcf if engine == "mujoco" and mjcf is not None else urdf
    if file is None:
        for rule in ENGINE_RULES:
            yield Row(rule, engine, "skip", "it is tried with URDFs alone")
        return
    tree = _read_tree(urdf, mjcf)
    if tree is not None and file == urdf:
        tree = freeze_mimics(tree)
    trial = Trial(engine, tree, request.get("lowest"), partial(load_world, engine, file, folder))
    yield from trial.rows(lambda rule: _emit(trying=rule))


def _read_tree(urdf: Path | None, mjcf: Path | None) -> Any:
    from export.check.mjcf_tree import UnsupportedMjcf, read_mjcf_tree
    from export.check.tree import build_tree
    from freeart21.files.urdf import read_urdf

    if urdf is not None:
        return build_tree(read_urdf(urdf))
    assert mjcf is not None
    try:
        return read_mjcf_tree(mjcf)
    except (UnsupportedMjcf, FreeArtError):
        return None
