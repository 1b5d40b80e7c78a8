"""The exporter's commands: tyro reads each function's signature, and the help its docstring."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from export.settings import ExportSettings, JointNumbers
from freeart21.processes import DOUBTFUL

Positional: Any = tyro.conf.Positional
Flat: Any = tyro.conf.arg(name="")
BY_ROLE = ExportSettings(names="role")


def export(
    result: Annotated[Path, Positional],
    out: Path,
    video: Path | None = None,
    settings: Annotated[ExportSettings, Flat] = BY_ROLE,
) -> int:
    """Export a result as a simulation-ready asset: URDF, MJCF, USD, meshes and loaders, reloaded and checked.

    The last line says whether to trust the result, as do the asset's files. The exit code is 3 if it is doubtful, or if
    collision shapes are far from the visible ones.

    Args:
        result: A result folder (with prediction.json).
        out: Asset folder to write.
        video: The reconstructed sequence folder, for textures from its sharpest frames.
    """
    from export.check.contact_rule import judge_contact
    from export.contact import read_link_shapes
    from export.exporter import export_result
    from freeart21.reconstruction import describe_trust

    asset = export_result(result, out, settings, video=video)
    print(asset.urdf)
    judged = judge_contact(*read_link_shapes(asset.urdf), asset.urdf.parent)
    if judged.verdict == "fail":
        print(f"{judged.rule} fails: {judged.reason}", file=sys.stderr)
    print(describe_trust(asset.trust))
    doubtful = asset.trust is not None and asset.trust.verdict == "doubtful"
    return DOUBTFUL if doubtful or judged.verdict == "fail" else 0


def joint_asset(out: Path, numbers: Annotated[JointNumbers, Flat]) -> None:
    """Write a URDF of one joint from a few numbers, for `gap` on a recorded joint without a URDF.

    Args:
        out: URDF file to write.
    """
    from export.joint_asset import write_joint_asset

    write_joint_asset(out, numbers)
    print(out)


def check_asset(
    path: Annotated[Path, Positional],
    engines: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME...")] = None,
    root: Path | None = None,
    simcheck: bool = False,
    as_json: Annotated[Path | None, tyro.conf.arg(name="json", metavar="FILE")] = None,
    limit_s: float = 60.0,
    certify: bool = False,
) -> int:
    """Check any URDF or MJCF: named rules on its files, and trials in every installed physics engine.

    Each engine loads it, compares it with the file's numbers, drives its joint through the range, releases it, and lets
    it rest on a plane. Exit code: 0 all rules pass, 3 a rule fails or ran out of time (unknown), 1 no asset.

    Args:
        path: An asset folder, a folder with one URDF or MJCF, or such a file.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
        engines: Some of sapien, mujoco, pybullet, drake; all installed ones when not given.
        simcheck: Also run the public checker of that name.
        as_json: File for the report: every rule with its verdict, reason, measured number and purpose.
        limit_s: Processor seconds for the files, and for each engine; three times that of wall-clock time.
        certify: Write the results into the certificate.json of an exported asset.
    """
    from export.certificate import add_trials
    from export.check.checking import check
    from export.check.report import print_report, write_report

    report = check(path, engines, simcheck=simcheck, root=root, limit_s=limit_s)
    print_report(report)
    if as_json is not None:
        write_report(as_json, report)
    if certify:
        add_trials(path, report)
    return 0 if report.verdict == "pass" else DOUBTFUL
