"""The rules judged from an asset's files alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from export.check.consistency_rules import RULES as CONSISTENCY_RULES
from export.check.consistency_rules import judge_consistency
from export.check.contact_rule import RULE as CONTACT
from export.check.contact_rule import judge_contact
from export.check.geometry_rules import check_shapes
from export.check.mjcf_tree import UnsupportedMjcf, read_mjcf_tree
from export.check.report import Row
from export.check.rules import FILE_RULES, GROUND_M, UNREAD
from export.check.tree import Tree, build_tree
from export.checklist import UNREADABLE, Files, Finding, Shapes, check_limits, check_urdf, load_shapes
from export.contact import is_closed
from export.inertia import find_unphysical
from export.stated_trust import read_stated_trust
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.asset_copy import list_mjcf_files
from freeart21.files.urdf import Urdf, read_urdf, read_urdf_parts
from freeart21.files.urdf_files import resolve_file
from freeart21.reconstruction import describe_trust

_FATAL = ("paths.exist", "inertia.physical", "limits.ordered", UNREADABLE)
"""Rules without which a trial is meaningless; for a link without inertia, engines invent one."""
SHAPE_RULES = ("inertia.fits-shape", "mass.possible", "collision.matches-visual", "axis.near", "parts.clear", CONTACT)
LAST_RULES = (*SHAPE_RULES, *CONSISTENCY_RULES)
"""Rules that need readable shapes; judged last, as they may take long."""
TRUST = "trust.sound"
_MAX_SHOWN = 3
"""Findings of one rule that are listed; of more, only the count."""


def judge_files(
    urdf: Path | None, mjcf: Path | None, folder: Path, facts: dict[str, Any], say: Callable[[str], None]
) -> Iterator[Row]:
    """A row for every rule on files. `say` is called with each rule that may take long, before it is judged.

    `facts` receives 'lowest', height in m of the lowest collision point in the root's frame with the joints as loaded
    (None without collision shapes), and 'blocked', why no engine can load it (empty if nothing is known).
    """
    facts |= {"lowest": None, "blocked": UNREAD}
    rows = [_judge_trust(urdf, mjcf)]
    if urdf is None:
        assert mjcf is not None
        yield from _judge_mjcf(mjcf, folder, facts, rows)
        return
    say(UNREADABLE)
    findings = check_urdf(urdf, folder)
    stop = [f for f in findings if f.item == "tree" or f.rule in _FATAL]
    facts["blocked"] = f"{stop[0].rule} fails" if stop else UNREAD
    rules = list(FILE_RULES)
    if not _are_numbers_readable(urdf):
        yield from make_rows(findings, dict.fromkeys(rules, facts["blocked"]), rows)
        return
    if any(f.item == "tree" or f.rule == "paths.exist" for f in findings):
        skipped = dict.fromkeys(rules[rules.index("inertia.centre-inside") :], "the tree or its files are not whole")
        yield from make_rows(findings, skipped, rows)
        return
    say("mesh.readable")
    files = partial(resolve_file, urdf, root=folder)
    seen: dict[str, Shapes] = {}
    try:
        read = read_urdf(urdf)
        tree = build_tree(read)
        findings += _check_visuals(read, files, seen)
        touched = {name: load_shapes(link.collisions, files) for name, link in read.links.items()}
    except FreeArtError as error:
        findings.append(Finding(UNREADABLE, str(error)))
        facts["blocked"] = f"{UNREADABLE} fails"
        skipped = dict.fromkeys((*LAST_RULES, "dynamics.damped", "stands.on-ground"), facts["blocked"])
        yield from make_rows(findings, skipped, rows)
        return
    findings += _check_damping(tree)
    say("stands.on-ground")
    skipped = {}
    findings += _check_ground(tree, touched, facts, skipped)
    facts["blocked"] = "" if not stop else facts["blocked"]
    yield from (row for row in make_rows(findings, skipped, rows) if row.rule not in LAST_RULES)
    say("parts.clear")  # may take long
    findings = [f for f in findings if f.rule in ("mesh.readable", "inertia.physical")]
    if findings:
        skipped = dict.fromkeys(LAST_RULES, f"{findings[0].rule} fails")
    else:
        findings = list(check_shapes(tree, seen, touched))
        say(CONTACT)
        rows.append(judge_contact(seen, touched, folder))
        say(CONSISTENCY_RULES[0])
        rows += judge_consistency(urdf, seen)
    yield from (row for row in make_rows(findings, skipped, rows) if row.rule in LAST_RULES)


def _are_numbers_readable(urdf: Path) -> bool:
    try:
        read_urdf_parts(urdf)
    except FreeArtError:
        return False
    return True


def make_rows(findings: list[Finding], skipped: dict[str, str], rows: list[Row]) -> Iterator[Row]:
    """A row for every rule on files: from `rows`, findings, or rules that were skipped."""
    ready = {row.rule: row for row in rows}
    for rule in FILE_RULES:
        if rule in ready:
            yield ready[rule]
            continue
        wrong = [finding.detail for finding in findings if finding.rule == rule]
        if wrong:
            more = f" (and {len(wrong) - _MAX_SHOWN} more)" if len(wrong) > _MAX_SHOWN else ""
            yield Row(rule, "file", "fail", "; ".join(wrong[:_MAX_SHOWN]) + more, float(len(wrong)), "findings")
        elif rule in skipped:
            yield Row(rule, "file", "skip", skipped[rule])
        else:
            yield Row(rule, "file", "pass")


def _judge_trust(urdf: Path | None, mjcf: Path | None) -> Row:
    """Whether the asset's files state that the underlying reconstruction is trusted."""
    try:
        trust = read_stated_trust(urdf, mjcf)
    except FreeArtError as error:
        return Row(TRUST, "file", "fail", str(error))
    if trust is None:
        return Row(TRUST, "file", "skip", "the asset states no trust in its reconstruction")
    return Row(TRUST, "file", "pass" if trust.verdict == "sound" else "fail", describe_trust(trust))


def _check_visuals(urdf: Urdf, files: Files, seen: dict[str, Shapes]) -> Iterator[Finding]:
    """Faults of the visual meshes; `seen` receives the readable ones, by link."""
    for name, link in urdf.links.items():
        for k, visual in enumerate(link.visuals):
            where = f"visual {k} of link '{name}'"
            try:
                shapes = load_shapes([visual], files)
            except Exception as error:  # parsers of many formats
                yield Finding("mesh.readable", f"{where}: {(str(error).splitlines() or [''])[0]}")
                continue
            seen.setdefault(name, []).extend(shapes)
            for _, mesh in shapes:
                if not len(mesh.faces) or not np.isfinite(mesh.vertices).all() or not mesh.area > 0:
                    yield Finding("mesh.readable", f"{where} has no surface")
                elif not is_closed(mesh):
                    yield Finding("mesh.watertight", f"{where} is not closed")


def _check_damping(tree: Tree) -> Iterator[Finding]:
    for joint in tree.movable:
        if not (joint.damping > 0 or joint.friction > 0):
            yield Finding("dynamics.damped", f"joint '{joint.name}' has neither damping nor friction")


def _check_ground(
    tree: Tree, touched: dict[str, Shapes], facts: dict[str, Any], skipped: dict[str, str]
) -> Iterator[Finding]:
    Ts = tree.link_poses(tree.complete({joint.name: joint.loaded for joint in tree.movable}))
    heights = [
        float(se3.transform(Ts[link] @ T, mesh.vertices)[:, 2].min())
        for link, shapes in touched.items()
        for T, mesh in shapes
        if len(mesh.vertices)
    ]
    if not heights:
        skipped["stands.on-ground"] = "it has no collision shapes"
        return
    facts["lowest"] = min(heights)
    if tree.fixed_base:
        skipped["stands.on-ground"] = "the file fixes it to the world"
    elif abs(min(heights)) > GROUND_M:
        detail = (
            f"its lowest collision point is at z = {1e3 * min(heights):.4g} mm, expected 0 within {1e3 * GROUND_M:g}"
        )
        yield Finding("stands.on-ground", detail)


def _judge_mjcf(mjcf: Path, folder: Path, facts: dict[str, Any], rows: list[Row]) -> Iterator[Row]:
    """Rows of an MJCF."""
    findings = [
        Finding("paths.exist", f"file '{file.name}' does not exist")
        for file in list_mjcf_files(mjcf, folder)
        if not file.is_file()
    ]
    facts["blocked"] = "paths.exist fails" if findings else ""
    judged = {"paths.exist"}
    try:
        tree = read_mjcf_tree(mjcf)
    except UnsupportedMjcf as error:
        why = str(error)
        yield from make_rows(findings, {rule: why for rule in FILE_RULES if rule not in judged}, rows)
        return
    except FreeArtError as error:
        tree = None
        findings.append(Finding(UNREADABLE, str(error)))
    judged |= {UNREADABLE, "tree.one-root", "tree.one-parent", "tree.links-exist"}
    if tree is not None:
        judged |= {"inertia.physical", "limits.ordered", "limits.zero-within", "dynamics.damped"}
        findings += [*_check_damping(tree), *_check_numbers(tree)]
    yield from make_rows(findings, {rule: "only for URDFs" for rule in FILE_RULES if rule not in judged}, rows)


def _check_numbers(tree: Tree) -> Iterator[Finding]:
    for name, body in tree.inertials.items():
        wrong = find_unphysical(body)
        if wrong:
            yield Finding("inertia.physical", f"body '{name}': {wrong}", broken=True)
    for joint in tree.movable:
        yield from (f for f in check_limits(joint) if f.rule in ("limits.ordered", "limits.zero-within"))
