"""The rules that are judged from the files alone."""

from __future__ import annotations

import importlib.util
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from export.check.contact_rule import RULE as CONTACT
from export.check.contact_rule import contact_row
from export.check.geometry_rules import shape_findings
from export.check.mjcf_tree import NotRead, named_files, tree_of_mjcf
from export.check.report import Row
from export.check.rules import FILE_RULES, GROUND_M, UNREAD
from export.check.tree import Tree, tree_of_urdf
from export.checklist import Files, Finding, shapes_of, urdf_findings
from export.delivered import Shapes, closed
from export.inertia import Inertial, unphysical
from export.stated_trust import stated_trust
from export.usd_reload import RULE as USD_RULE
from export.usd_reload import usd_findings
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.urdf import parse_urdf, read_urdf
from freeart21.files.urdf_files import resolve_file
from freeart21.reconstruction import describe_trust

_FATAL = ("paths.exist", "inertia.physical", "limits.ordered", "numbers and meshes")
"""Rules without which a trial says nothing; a link without inertia gets one of the engine's own."""
SHAPE_RULES = ("inertia.fits-shape", "collision.matches-visual", "parts.clear", CONTACT)
TRUST = "trust.sound"
_SHOWN = 3
"""Findings of one rule that are told; of more, how many."""


def file_rows(
    urdf: Path | None, mjcf: Path | None, folder: Path, facts: dict[str, Any], say: Callable[[str], None]
) -> Iterator[Row]:
    """A row for every rule of the files, `say` told each one that may take long.

    `facts` gets 'lowest', the height, m, of the lowest collision point in the root's frame with the joints as loaded
    (None when nothing collides), and 'blocked', why no engine can be expected to load it (empty when nothing speaks
    against it).
    """
    facts |= {"lowest": None, "blocked": UNREAD}
    rows = [_trust(urdf, mjcf)]
    if urdf is None:
        assert mjcf is not None
        yield from _mjcf_rows(mjcf, folder, facts, rows)
        return
    say("numbers and meshes")
    robot = parse_urdf(urdf)
    findings = urdf_findings(robot, urdf, folder)
    stop = [f for f in findings if f.item == "tree" or f.rule in _FATAL]
    facts["blocked"] = f"{stop[0].rule} fails" if stop else UNREAD
    if any(f.item == "tree" or f.rule == "paths.exist" for f in findings):
        skipped = dict.fromkeys(
            list(FILE_RULES)[list(FILE_RULES).index("inertia.centre-inside") :], "the tree or its files are not whole"
        )
        yield from rows_of(findings, skipped, rows)
        return
    say("mesh.readable")
    files = partial(resolve_file, urdf, root=folder)
    seen: dict[str, Shapes] = {}
    findings += _visuals(robot, files, seen)
    try:
        tree = tree_of_urdf(read_urdf(urdf))
        touched = {link.get("name", ""): shapes_of(link, "collision", files) for link in robot.findall("link")}
    except FreeArtError as error:
        findings.append(Finding("numbers and meshes", str(error)))
        facts["blocked"] = "numbers and meshes fails"
        skipped = dict.fromkeys((*SHAPE_RULES, "dynamics.damped", USD_RULE, "stands.on-ground"), facts["blocked"])
        yield from rows_of(findings, skipped, rows)
        return
    findings += _damped(tree)
    say("stands.on-ground")
    skipped = {}
    findings += _ground(tree, touched, facts, skipped)
    facts["blocked"] = "" if not stop else facts["blocked"]
    say(USD_RULE)
    rows.append(_usd(urdf))
    yield from (row for row in rows_of(findings, skipped, rows) if row.rule not in SHAPE_RULES)
    say("parts.clear")  # from here on it may take long
    findings = [f for f in findings if f.rule in ("mesh.readable", "inertia.physical")]
    if findings:
        skipped = dict.fromkeys(SHAPE_RULES, f"{findings[0].rule} fails")
    else:
        findings = list(shape_findings(tree, seen, touched))
        say(CONTACT)
        rows.append(contact_row(seen, touched, folder))
    yield from (row for row in rows_of(findings, skipped, rows) if row.rule in SHAPE_RULES)


def rows_of(findings: list[Finding], skipped: dict[str, str], rows: list[Row]) -> Iterator[Row]:
    """A row for every rule of the files: of `rows`, else from what is wrong and what was not judged."""
    ready = {row.rule: row for row in rows}
    for rule in FILE_RULES:
        if rule in ready:
            yield ready[rule]
            continue
        wrong = [finding.detail for finding in findings if finding.rule == rule]
        if wrong:
            more = f" (and {len(wrong) - _SHOWN} more)" if len(wrong) > _SHOWN else ""
            yield Row(rule, "file", "fail", "; ".join(wrong[:_SHOWN]) + more, float(len(wrong)), "findings")
        elif rule in skipped:
            yield Row(rule, "file", "skip", skipped[rule])
        else:
            yield Row(rule, "file", "pass")


def _trust(urdf: Path | None, mjcf: Path | None) -> Row:
    """Whether the asset's files say that the reconstruction behind them trusts itself."""
    try:
        trust = stated_trust(urdf, mjcf)
    except FreeArtError as error:
        return Row(TRUST, "file", "fail", str(error))
    if trust is None:
        return Row(TRUST, "file", "skip", "the asset does not say whether to trust what it was made of")
    return Row(TRUST, "file", "pass" if trust.verdict == "sound" else "fail", describe_trust(trust))


def _usd(urdf: Path) -> Row:
    """Whether the USD layer of an asset of ours says the same as its URDF."""
    layer = urdf.with_suffix(".usdc")
    if not (urdf.parent / "asset.json").is_file() or not layer.exists():
        return Row(USD_RULE, "file", "skip", "`export` wrote no USD beside it")
    if importlib.util.find_spec("pxr") is None:
        return Row(USD_RULE, "file", "skip", f"{layer.name} was not read: usd-core is not installed")
    try:
        found = [finding.detail for finding in usd_findings(layer, read_asset(urdf.parent))]
    except FreeArtError as error:
        found = [str(error)]
    return Row(USD_RULE, "file", "fail" if found else "pass", "; ".join(found[:_SHOWN]))


def _visuals(robot: ET.Element, files: Files, seen: dict[str, Shapes]) -> Iterator[Finding]:
    """What is wrong with the visual meshes; `seen` gets those that can be read, by link."""
    for link in robot.findall("link"):
        for k, visual in enumerate(link.findall("visual")):
            alone = ET.Element("link", link.attrib)
            alone.append(visual)
            where = f"visual {k} of link '{link.get('name')}'"
            try:
                shapes = shapes_of(alone, "visual", files)
            except Exception as error:  # parsers of many formats
                yield Finding("mesh.readable", f"{where}: {(str(error).splitlines() or [''])[0]}")
                continue
            seen.setdefault(link.get("name", ""), []).extend(shapes)
            for _, mesh in shapes:
                if not len(mesh.faces) or not np.isfinite(mesh.vertices).all() or not mesh.area > 0:
                    yield Finding("mesh.readable", f"{where} has no surface")
                elif not closed(mesh):
                    yield Finding("mesh.watertight", f"{where} is not closed")


def _damped(tree: Tree) -> Iterator[Finding]:
    for joint in tree.movable:
        if not (joint.damping > 0 or joint.friction > 0):
            yield Finding("dynamics.damped", f"joint '{joint.name}' has neither damping nor friction")


def _ground(
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
        skipped["stands.on-ground"] = "nothing of it collides"
        return
    facts["lowest"] = min(heights)
    if tree.nailed:
        skipped["stands.on-ground"] = "the file nails it to the world"
    elif abs(min(heights)) > GROUND_M:
        said = f"its lowest collision point is at z = {1e3 * min(heights):.4g} mm, expected 0 within {1e3 * GROUND_M:g}"
        yield Finding("stands.on-ground", said)


def _mjcf_rows(mjcf: Path, folder: Path, facts: dict[str, Any], rows: list[Row]) -> Iterator[Row]:
    """What can be said of an MJCF without MuJoCo."""
    findings = [
        Finding("paths.exist", f"file '{file.name}' does not exist")
        for file in named_files(mjcf, folder)
        if not file.is_file()
    ]
    facts["blocked"] = "paths.exist fails" if findings else ""
    judged = {"paths.exist"}
    try:
        tree = tree_of_mjcf(mjcf)
    except NotRead as error:
        why = f"{error}, which only MuJoCo reads"
        yield from rows_of(findings, {rule: why for rule in FILE_RULES if rule not in judged}, rows)
        return
    except FreeArtError as error:
        tree = None
        findings.append(Finding("numbers and meshes", str(error)))
    judged |= {"numbers and meshes", "tree.one-root", "tree.one-parent", "tree.links-exist"}
    if tree is not None:
        judged |= {"inertia.physical", "limits.ordered", "limits.zero-within", "dynamics.damped"}
        findings += [*_damped(tree), *_numbers(tree)]
    yield from rows_of(findings, {rule: "of URDFs alone" for rule in FILE_RULES if rule not in judged}, rows)


def _numbers(tree: Tree) -> Iterator[Finding]:
    for name, body in tree.inertials.items():
        wrong = unphysical(Inertial(body.mass, body.centre, body.inertia))
        if wrong:
            yield Finding("inertia.physical", f"body '{name}': {wrong}", broken=True)
    for joint in tree.movable:
        said = f"joint '{joint.name}' has limits {joint.lower:g} to {joint.upper:g}"
        if not joint.ordered:
            yield Finding("limits.ordered", f"{said}, expected lower < upper")
        elif not joint.lower <= 0 <= joint.upper:
            yield Finding("limits.zero-within", f"{said}, expected zero within")
