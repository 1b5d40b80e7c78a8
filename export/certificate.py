"""Makes an asset's certificate by measuring its files, and adds what engines make of it."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from export.check.report import CheckReport
from export.checklist import Shapes
from export.contact import measure_contact_depth, measure_contact_fidelity, read_link_shapes
from export.fidelity import Fidelity
from export.joint_range import STATES
from export.penetration import measure_visual_depth
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.certificate import (
    FILE,
    Certificate,
    EngineResult,
    LinkCertificate,
    read_certificate,
    write_certificate,
)
from freeart21.files.trust_json import trust_to_json
from freeart21.files.urdf import Urdf, read_urdf
from freeart21.mesh import Mesh

UNKNOWN = "not known"
TOLERANCE = 1e-3
"""Relative difference of numbers, and of lengths over the asset's size, that rounding and libraries may make."""


@dataclass(frozen=True)
class MeasuredFiles:
    """Geometry of an asset, measured from its files."""

    visuals: dict[str, Shapes]
    """By link."""
    fidelity: dict[str, Fidelity]
    """Contact distances by link."""
    visual_depth: float
    """m that the visual meshes of the joint's links are in each other at most, in its range."""
    contact_depth: float
    """The same of collision shapes."""


def measure_files(urdf: Path, joint: str, fidelity: bool = True) -> MeasuredFiles:
    """Contact distances (unless `fidelity` is false) and overlaps of a URDF's links at one of its joints."""
    visuals, collisions = read_link_shapes(urdf)
    return MeasuredFiles(
        visuals,
        measure_contact_fidelity(visuals, collisions) if fidelity else {},
        measure_visual_depth(read_urdf(urdf).joints[joint], visuals, STATES),
        measure_contact_depth(urdf, joint, collisions, STATES),
    )


def certify(asset: Asset, measured: MeasuredFiles | None = None) -> Certificate:
    """The certificate of an exported asset, from its URDF, meshes and asset.json; no engines yet.

    `measured` are its files, where they were measured already.
    """
    measured = measure_files(asset.urdf, asset.joint) if measured is None else measured
    urdf, up = read_urdf(asset.urdf), _read_facts(asset.source, "up")
    trust = trust_to_json(asset.trust)
    links = {"reference": asset.reference_link, "moving": asset.moving_link}
    return Certificate(
        {link: _certify_link(asset, urdf, part, link, measured) for part, link in links.items()},
        measured.visual_depth,
        measured.contact_depth,
        str(up.get("how", UNKNOWN)),
        trust["verdict"],
        tuple(trust["reasons"]),
    )


def _certify_link(asset: Asset, urdf: Urdf, part: str, link: str, measured: MeasuredFiles) -> LinkCertificate:
    facts = _read_facts(_read_facts(asset.source, "parts"), part)
    mass = _read_facts(facts, "mass")
    inertial = urdf.links[link].inertial
    if inertial is None:
        raise FreeArtError(f"{asset.urdf}: link '{link}' has no mass, expected an exported asset")
    seen, supposed = measure_seen_share(measured.visuals[link], _read_facts(facts, "patch"))
    low, high = mass.get("bounds_kg") or (inertial.mass, inertial.mass)
    contact = measured.fidelity[link].to_json() if link in measured.fidelity else {}
    source = f"{'guessed' if mass.get('guessed') else 'given'} {mass.get('by', UNKNOWN)}"
    material = str(mass.get("material", UNKNOWN))
    return LinkCertificate(part, seen, supposed, contact, source, material, inertial.mass, float(low), float(high))


def measure_seen_share(visuals: Shapes, patch: Mapping[str, Any]) -> tuple[float, dict[str, float]]:
    """Share of the area of a link's visual mesh that was seen, and that of the rest by how it was supplied.

    `patch` is asset.json's `source.parts.*.patch`: triangles from `first_face` on were supplied, the first
    `symmetric_faces` of them by a symmetry of what was seen, the last `panel_faces` as backs of panels. Without it
    everything counts as seen.
    """
    area = np.concatenate([Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)).areas() for _, mesh in visuals])
    first = int(patch.get("first_face", len(area)))
    panels = max(first, len(area) - int(patch.get("panel_faces", 0)))
    copies = min(max(first, first + int(patch.get("symmetric_faces", 0))), panels)
    total = max(float(area.sum()), 1e-300)
    parts = {
        "symmetry": area[first:copies],
        "closing surface": area[copies:panels],
        "back of a panel": area[panels:],
    }
    return float(area[:first].sum()) / total, {how: float(a.sum()) / total for how, a in parts.items() if len(a)}


def list_reloaded() -> dict[str, EngineResult]:
    """The engines in which `export.checklist.check_asset` compares the poses of a new asset."""
    return {
        name: EngineResult(metadata.version(name), "reloaded")
        for name in ("sapien", "mujoco")
        if importlib.util.find_spec(name) is not None
    }


def find_differences(certificate: Certificate, measured: Certificate, size: float) -> list[str]:
    """What a certificate states otherwise than the files, as one line each.

    `size` is the asset's diagonal, m: overlaps may differ by `TOLERANCE` of it, and shares and masses by `TOLERANCE`.
    Contact is compared where it is measured (`export.check.contact_rule`).
    """
    found = []
    for name in ("trust", "upright"):
        if getattr(certificate, name) != getattr(measured, name):
            found.append(f"it states {name} '{getattr(certificate, name)}', the files '{getattr(measured, name)}'")
    for name in ("visual_overlap_m", "contact_overlap_m"):
        stated, true = getattr(certificate, name), getattr(measured, name)
        if abs(stated - true) > TOLERANCE * size:
            found.append(f"it states {name} {1000 * stated:.3g} mm, the files have {1000 * true:.3g} mm")
    if set(certificate.links) != set(measured.links):
        return [*found, f"it is of links {', '.join(certificate.links)}, expected {', '.join(measured.links)}"]
    for link, true in measured.links.items():
        for name in ("mass_kg", "mass_low_kg", "mass_high_kg", "seen_share"):
            stated, value = getattr(certificate.links[link], name), getattr(true, name)
            if abs(stated - value) > TOLERANCE * max(abs(value), 1e-12 if "kg" in name else 1.0):
                found.append(f"it states {name} {stated:.4g} of '{link}', the files {value:.4g}")
        for name in ("mass", "material"):
            words = [getattr(of, name) for of in (certificate.links[link], true)]
            if words[0] != words[1]:
                found.append(f"it states {name} '{words[0]}' of '{link}', the files '{words[1]}'")
    return found


def add_trials(folder: Path, report: CheckReport) -> Certificate:
    """Write what `check-asset` found into the certificate of the asset in `folder`, made anew where it has none.

    Raises FreeArtError when the folder is no exported asset.
    """
    certificate = read_certificate(folder)
    if certificate is None:
        asset = read_asset(folder)
        if "parts" not in asset.source:
            raise FreeArtError(f"{folder} is no exported asset, so it has no {FILE}")
        certificate = certify(asset)
    certificate = replace(certificate, engines=_sum_up(report))
    write_certificate(folder, certificate)
    return certificate


def _sum_up(report: CheckReport) -> dict[str, EngineResult]:
    """Engine to its worst verdict and the rules that fail; 'file' for the rules on files."""
    found = {}
    for engine in dict.fromkeys(row.engine for row in report.rows):
        rows = tuple(row for row in report.rows if row.engine == engine)
        if all(row.verdict == "skip" for row in rows):
            continue
        own = replace(report, rows=rows)
        failed = tuple(row.rule for row in own.not_passed)
        found[engine] = EngineResult(report.engines.get(engine, ""), own.verdict, failed)
    return found


def _read_facts(source: Mapping[str, Any], key: str) -> dict[str, Any]:
    """The object `key` of facts from asset.json, empty where there is none."""
    found = source.get(key)
    return dict(found) if isinstance(found, Mapping) else {}
