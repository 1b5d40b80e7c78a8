"""Rules on an exported asset's files against each other: visual meshes, certificate, and copies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from export.certificate import certify, find_differences, measure_files
from export.check.report import Row
from export.check.rules import VISUAL_DEPTH_M
from export.check.same_asset import RULES as COPIES
from export.check.same_asset import USD, judge_copy
from export.checklist import Shapes
from freeart21 import processes, se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.certificate import Certificate, read_certificate

VISUALS, CERTIFIED = "parts.visuals-clear", "certificate.same"
RULES = (VISUALS, CERTIFIED, *COPIES)
_MAX_SHOWN = 3
"""Differences that a reason lists."""


def judge_consistency(urdf: Path, seen: Mapping[str, Shapes]) -> Iterator[Row]:
    """A row of each of `RULES`, skipped for what `export` did not write.

    Args:
        urdf: the asset's URDF.
        seen: visual shapes by link.
    """
    exported = (urdf.parent / "asset.json").is_file()
    try:
        asset = read_asset(urdf.parent) if exported else None
    except FreeArtError as error:
        yield from (Row(rule, "file", "fail", str(error)) for rule in RULES)
        return
    if asset is None or "parts" not in asset.source:
        own = () if asset is None else (USD,)  # of an asset that was repaired, too
        yield from (Row(rule, "file", "skip", "it was not written by `export`") for rule in RULES if rule not in own)
        yield from (judge_copy(rule, asset) for rule in own if asset is not None)
        return
    try:
        measured = certify(asset, measure_files(asset.urdf, asset.joint, fidelity=False))
    except Exception as error:  # links that the URDF lacks, or facts of any type
        reason = f"it cannot be measured: {processes.one_line(error)[:300]}"
        yield from (Row(rule, "file", "fail", reason) for rule in (VISUALS, CERTIFIED))
    else:
        depth = measured.visual_overlap_m
        reason = f"visual meshes are {1000 * depth:.3g} mm in each other, expected at most {1000 * VISUAL_DEPTH_M:g}"
        yield Row(VISUALS, "file", "pass" if depth <= VISUAL_DEPTH_M else "fail", reason, depth, "m")
        yield _judge_certificate(asset, measured, seen)
    yield from (judge_copy(rule, asset) for rule in COPIES)


def _judge_certificate(asset: Asset, measured: Certificate, seen: Mapping[str, Shapes]) -> Row:
    folder = asset.urdf.parent
    try:
        stated = read_certificate(folder)
    except FreeArtError as error:
        return Row(CERTIFIED, "file", "fail", str(error))
    if stated is None:
        return Row(CERTIFIED, "file", "skip", "there is no certificate.json")
    corners = [se3.transform(T, mesh.vertices) for shapes in seen.values() for T, mesh in shapes]
    found = find_differences(stated, measured, float(np.linalg.norm(np.ptp(np.concatenate(corners), axis=0))))
    return Row(CERTIFIED, "file", "fail" if found else "pass", "; ".join(found[:_MAX_SHOWN]))
