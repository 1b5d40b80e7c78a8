"""The exporter's commands: tyro reads each function's signature, and the help its docstring."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from freeart21.errors import FreeArtError
from freeart21.processes import DOUBTFUL

Positional: Any = tyro.conf.Positional
Masses = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="KG | NAME=KG...")]
Materials = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="MATERIAL | NAME=MATERIAL...")]
Direction = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")]


@dataclass(frozen=True)
class ExportOptions:
    """What `export` makes of a result."""

    density: float | None = None
    """Density of both parts, kg/m^3; that of the material when not given, as video shows no mass."""
    mass: Masses = None
    """Mass of the whole object instead, kg, split between the parts by volume and density, or of parts by their link's
    name, as base=2.2 drawer=.5."""
    material: Materials = None
    """Material of both parts, or of each by its link's name, as base=steel drawer=wood, also for friction and
    restitution: plastic, wood, steel, aluminium, glass, rubber, cardboard; plastic (1050 kg/m^3) when not given."""
    wall: float | None = None
    """Wall thickness of hollow parts, m; solid parts when not given."""
    dynamics: Literal["guessed", "none"] = "guessed"
    """Damping and friction of the joint, which the video does not show: small guessed values, or none."""
    contact: Literal["fine", "fast"] = "fine"
    """Collision shapes: fine, within about a millimetre; or fast, at most 16 a part."""
    scale: float = 1.0
    """Factor for all lengths. Assets of another scale than 1 are not scored."""
    up: Direction = None
    """Direction that becomes z, in the result's canonical frame (ours: the camera's of the first frame, right, down,
    forward); from gravity or the likeliest resting pose when not given."""
    gravity: Direction = None
    """Direction of gravity in the camera's axes (right, down, forward) of the first frame, 0 9.81 0 for a level camera;
    only when the reference part stood still before the camera."""
    zero: Literal["first", "closed", "lower", "upper"] = "closed"
    """Joint position that becomes zero: that of the first frame, the end where both parts fill the least space
    (closed), or the lower or upper end."""
    names: Literal["role", "part"] = "role"
    """Links are named by their role (base; lid, door, drawer, slider, handle, or part where it is unclear), or
    reference and moving (part)."""
    base: Literal["free", "fixed"] = "free"
    """Whether the reference part moves freely or is fixed in the world (in URDF to a link named world)."""
    usd: Literal["auto", "yes", "no"] = "auto"
    """Write object.usdc too; auto: if usd-core is installed."""


def export(
    result: Annotated[Path, Positional],
    out: Path,
    video: Path | None = None,
    options: Annotated[ExportOptions, tyro.conf.arg(name="")] = ExportOptions(),
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
    from export.exporter import ExportSettings, export_result
    from export.losses import describe_limitations
    from export.placement import PlacementSettings
    from freeart21.reconstruction import describe_trust

    given = {**vars(options)}
    placement = PlacementSettings(given.pop("up"), given.pop("gravity"), given.pop("zero"))
    given["mass"] = _read_by_part("mass", options.mass, _read_kilograms)
    given["material"] = _read_by_part("material", options.material, str)
    given["usd"] = {"auto": None, "yes": True, "no": False}[options.usd]
    settings = ExportSettings(**given, placement=placement)
    asset = export_result(result, out, settings, video=video)
    print(asset.urdf)
    for line in describe_limitations(asset):
        print(line, file=sys.stderr)
    judged = judge_contact(*read_link_shapes(asset.urdf), asset.urdf.parent)
    if judged.verdict == "fail":
        print(f"{judged.rule} fails: {judged.reason}", file=sys.stderr)
    print(describe_trust(asset.trust))
    doubtful = asset.trust is not None and asset.trust.verdict == "doubtful"
    return DOUBTFUL if doubtful or judged.verdict == "fail" else 0


def _read_by_part(option: str, words: tuple[str, ...] | None, read: Callable[[str], Any]) -> Any:
    """One value for all parts, or a dictionary of NAME=VALUE; None without words."""
    if not words:
        return None
    if len(words) == 1 and "=" not in words[0]:
        return read(words[0])
    pairs = [word.partition("=") for word in words]
    if wrong := [word for word, (name, _, value) in zip(words, pairs, strict=True) if not (name and value)]:
        raise FreeArtError(f"--{option} has '{wrong[0]}', expected one value, or NAME=VALUE for each part")
    return {name: read(value) for name, _, value in pairs}


def _read_kilograms(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise FreeArtError(f"--mass has '{text}', expected kg") from error


def joint_asset(
    out: Path,
    mass: float,
    kind: Literal["pendulum", "door", "drawer"] = "pendulum",
    length: float | None = None,
    inertia: float | None = None,
    period: float | None = None,
    lower: float | None = None,
    upper: float | None = None,
    joint: str = "hinge",
) -> None:
    """Write a URDF of one joint from a few numbers, for `gap` on a recorded joint without a URDF.

    Args:
        out: URDF file to write.
        mass: Mass of the moving part, kg.
        kind: A pendulum turns about y and hangs down at 0, a door turns about z, a drawer slides along x; z is up.
        length: Distance from the joint's axis to the centre of mass, m; 0 for a rotor (with --kind door).
        inertia: Inertia about the joint's axis, kg*m^2; that of a point mass at the length when not given.
        period: Period of small free swings of the pendulum, s: gives the length or, with --length, the inertia.
        lower: Lower limit of the joint, rad or m; no limits when not given.
        upper: Upper limit of the joint, rad or m.
        joint: Name of the joint.
    """
    from export.joint_asset import JointNumbers, write_joint_asset

    write_joint_asset(out, JointNumbers(kind, mass, length, inertia, period, lower, upper, joint))
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
