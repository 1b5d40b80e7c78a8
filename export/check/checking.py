"""Entry point of `check-asset`: the rules on an asset's files, and its trial in every installed engine."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from export.check.engines.base import MODULES, SETTINGS
from export.check.engines.plain_urdf import READ_BY_ENGINES
from export.check.report import CheckReport, Row
from export.check.rules import ENGINE_RULES, UNREAD
from export.check.subject import find_subject
from export.check.trial_process import run_stage
from freeart21.errors import FreeArtError
from freeart21.files.urdf import read_urdf_parts

ENGINES = tuple(MODULES)
TIME_LIMIT_S = 60.0
"""s of processor time for the files, or for one engine: three times what the heaviest known asset needs."""
SIMCHECK_LIMIT_S = 900.0
"""The same for simcheck, which tests 240 points of each contact mesh against each shape of the link: quadratic in the
shapes. Measured with MuJoCo on an idle machine: 6 s for 58 shapes, 43 s for 226, 160 s of processor time for 429;
our assets have 512 at most. Its own limit is 240 s per engine."""


def check(
    path: Path,
    engines: Iterable[str] | None = None,
    *,
    simcheck: bool = False,
    root: Path | None = None,
    limit_s: float = TIME_LIMIT_S,
) -> CheckReport:
    """Judge the asset at `path` by every rule: an asset folder, a folder with one URDF or MJCF, or such a file.

    Args:
        path: the asset, untrusted.
        engines: names in `ENGINES`; None is all of them. Those not installed are skipped.
        simcheck: also run the public checker of that name.
        root: folder that bounds all files; None: the asset's own or, for a URDF, its package's.
        limit_s: s of processor time for the files, and for each engine; simcheck gets at least 900.

    Each engine runs in a process of its own, one after the other. Raises FreeArtError when there is no asset at `path`,
    a file lies outside the root, an engine is unknown, or the limit is no time.
    """
    if not 0 < limit_s < math.inf:
        raise FreeArtError(f"--limit-s is {limit_s:g}, expected seconds, more than 0")
    wanted = ENGINES if engines is None else tuple(engines)
    for engine in wanted:
        if engine not in ENGINES:
            raise FreeArtError(f"there is no engine '{engine}'; engines: {', '.join(ENGINES)}")
    if simcheck and importlib.util.find_spec("simcheck") is None:
        raise FreeArtError("simcheck is not installed: pip install 'freeart21[simcheck]'")
    subject = find_subject(path, root)
    notes, unknown = _collect_notes(subject.urdf)
    request: dict[str, Any] = {
        "folder": str(subject.folder.absolute()),
        "urdf": subject.urdf and str(subject.urdf.absolute()),
        "mjcf": subject.mjcf and str(subject.mjcf.absolute()),
    }
    answer = run_stage({**request, "engine": "file"}, limit_s)
    rows, versions, seconds, settings = list(answer.rows), {}, {"file": answer.seconds}, {}
    request["lowest"] = answer.facts.get("lowest")
    blocked = answer.facts.get("blocked", UNREAD) or unknown
    for engine in wanted:
        if importlib.util.find_spec(MODULES[engine]) is None:
            versions[engine] = "not installed"
            rows += [Row(rule, engine, "skip", "not installed") for rule in ENGINE_RULES]
        elif blocked:
            rows += [Row(rule, engine, "skip", blocked) for rule in ENGINE_RULES]
        else:
            answer = run_stage({**request, "engine": engine}, limit_s)
            rows += answer.rows
            versions[engine] = str(answer.facts.get("version", ""))
            settings[engine] = SETTINGS[engine]
            seconds[engine] = answer.seconds
    if simcheck:
        most = max(limit_s, SIMCHECK_LIMIT_S)
        answer = run_stage({**request, "engine": "simcheck", "limit_s": most}, most)
        rows += answer.rows
        versions["simcheck"] = str(answer.facts.get("version", ""))
        seconds["simcheck"] = answer.seconds
    return CheckReport(str(path), tuple(rows), versions, settings, seconds, notes)


def _collect_notes(urdf: Path | None) -> tuple[tuple[str, ...], str]:
    """Changes made to a URDF for the trials, and why no trial is possible if so."""
    try:
        links, joints = ([], []) if urdf is None else read_urdf_parts(urdf)
    except FreeArtError:  # reported by the rules on files
        return (), ""
    held = (f"joint '{j.name}' follows '{j.mimic[0]}' (mimic): trials hold it" for j in joints if j.mimic)
    free = [f"joint '{j.name}' is {j.type}" for j in joints if j.joint_type is None and j.type != "fixed"]
    files = {shape.filename for link in links for shape in link.collisions if shape.kind == "mesh"}
    others = {name for name in files if Path(name).suffix.lower() not in READ_BY_ENGINES}
    converted = (f"collision mesh {name} is given to the engines as an OBJ" for name in sorted(others))
    return (*held, *converted), f"{free[0]}, and only hinges and sliders are tried" if free else ""
