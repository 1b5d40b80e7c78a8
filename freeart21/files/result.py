"""A result folder: a method's answer for one sequence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.diagnostics import Diagnostics, write_diagnostics
from freeart21.files.gaussians import GAUSSIANS, read_gaussians, write_gaussians
from freeart21.files.joint_json import joint_from_json, joint_to_json
from freeart21.files.mesh_file import read_ply, write_ply
from freeart21.files.places import RESULT
from freeart21.files.trust_json import trust_from_json, trust_to_json
from freeart21.gaussians import Gaussians
from freeart21.reconstruction import PIECES, Alternative, Failure, Piece, Reconstruction

SCHEMA = "freeart21/prediction/1"
METHOD_SCHEMA = "freeart21/method/1"
MAX_FRAMES, MAX_ALTERNATIVES = 100_000, 10
RENDERS = ("renders", "renders_other")
"""Folders of the held-out views: posed by the result's reference part, and by its moving part."""


@dataclass(frozen=True)
class Method:
    """Who made a set of results: method.json."""

    name: str
    code: str = ""
    """Address and version of the code."""
    settings: dict[str, Any] | None = None
    hardware: str = ""
    lacks: tuple[Piece, ...] = ()
    """Pieces that it never makes: their metrics are left out without a penalty, and the files hold placeholders."""


def write_method(folder: Path, method: Method) -> None:
    """Write method.json of a results folder."""
    atomic.write_json(
        folder / "method.json",
        {
            "schema": METHOD_SCHEMA,
            "name": method.name,
            "code": method.code,
            "settings": method.settings or {},
            "hardware": method.hardware,
            **({"lacks": list(method.lacks)} if method.lacks else {}),
        },
    )


def write_own_method(folder: Path, method: Method) -> bool:
    """Write method.json if `folder` is a folder of this method's results; gives whether it did.

    It is, when its method.json has the same `code` up to the version or, without method.json, when it holds only
    results and hidden files.
    """
    if (folder / "method.json").exists():
        try:
            ours = read_method(folder).code.split(" ")[0] == method.code.split(" ")[0]
        except FreeArtError:
            ours = False
    else:
        seen = [path for path in folder.iterdir() if not path.name.startswith(".")]
        ours = all((path / "prediction.json").is_file() for path in seen)
    if ours:
        write_method(folder, method)
    return ours


def read_method(folder: Path) -> Method:
    """The method of a results folder; one without method.json is named after the folder."""
    path = folder / "method.json"
    if not checked.is_there(path):
        return Method(folder.name)
    data = checked.read_json(path, METHOD_SCHEMA)
    words = [str(data.get(key, "")) for key in ("code", "hardware")]
    return Method(checked.text(data, "name", path), words[0], data.get("settings"), words[1], read_lacks(data, path))


def read_lacks(data: dict[str, Any], path: Path) -> tuple[Piece, ...]:
    """The optional 'lacks' of method.json; raises FreeArtError naming `path`."""
    given = data.get("lacks", [])
    if not isinstance(given, list) or not all(piece in PIECES for piece in given):
        raise FreeArtError(f"{path}: 'lacks' is {checked.shorten(given)}, expected a list of {', '.join(PIECES)}")
    return tuple(piece for piece in PIECES if piece in given)


RESULT_FILES = (
    *("prediction.json", "poses.npz", "diagnostics.json", GAUSSIANS, "parts/reference.ply", "parts/moving.ply"),
    *(f"{folder}/{'[0-9]' * 5}.png" for folder in ("part_mask", "confidence", "renders", "renders_other")),
    *(f"asset/{name}.json" for name in ("asset", "certificate", "effects")),
    *(f"asset/{name}" for name in ("object.urdf", "object.xml", "object.usdc", "preview.png", GAUSSIANS)),
    *("asset/loaders/load_*.py", "asset/loaders/joint.json", *(f"asset/meshes/*.{e}" for e in ("obj", "mtl", "png"))),
)
"""Patterns (fnmatch; '*' crosses '/') of the files of a result with its asset."""


def write_result(
    folder: Path,
    result: Reconstruction | Failure,
    settings: dict[str, Any] | None = None,
    renders: list[NDArray[np.uint8]] | None = None,
    diagnostics: Diagnostics | None = None,
    renders_other: list[NDArray[np.uint8]] | None = None,
) -> None:
    """Write one result folder. An older result, with its asset, is replaced; FreeArtError when anything else is there.

    `renders` are the held-out views (height, width, 3), `renders_other` the same with both parts' roles exchanged.
    """
    with atomic.new_folder(folder, RESULT) as aside:
        if isinstance(result, Failure):
            atomic.write_json(
                aside / "prediction.json",
                {
                    "schema": SCHEMA,
                    "status": "failed",
                    "stage": result.stage,
                    "reason": result.reason,
                    "seconds": result.seconds,
                    "settings": settings or {},
                },
            )
            return
        n = len(result)
        std = result.state_std if result.state_std is not None else np.full(n, np.nan)
        joint = result.articulation.joint
        optional: dict[str, Any] = {} if result.trust is None else {"trust": trust_to_json(result.trust)}
        if result.axis_std is not None or result.pivot_std is not None:
            optional["joint_std"] = {"axis_rad": result.axis_std, "pivot_m": result.pivot_std}
        if result.alternatives:
            optional["alternatives"] = [_alternative_to_json(other) for other in result.alternatives]
        atomic.write_json(
            aside / "prediction.json",
            {
                "schema": SCHEMA,
                "status": "ok",
                **optional,
                "joint": joint_to_json(joint),
                "states": result.states,
                "state_unit": joint.state_unit,
                "state_std": std,
                "seen": result.seen,
                "seconds": result.seconds,
                "settings": settings or {},
                **({"anchor": result.anchor} if result.anchor else {}),
            },
        )
        covariances = result.covariances if result.covariances is not None else np.full((n, 2, 6, 6), np.nan)
        np.savez_compressed(
            aside / "poses.npz",
            T_camera_reference=result.Ts_camera_reference,
            T_camera_moving=result.Ts_camera_moving,
            covariances=covariances,
            seen=result.seen,
        )
        for i, mask in enumerate(result.part_masks):
            atomic.write_bytes(aside / "part_mask" / f"{i:05d}.png", checked.encode_png(mask))
        for name in PARTS:
            write_ply(aside / "parts" / f"{name}.ply", result.articulation.part(name))
        if result.appearance is not None:
            write_gaussians(aside / GAUSSIANS, result.appearance)
        if diagnostics is not None:
            write_diagnostics(aside, diagnostics)
        for other, images in enumerate((renders, renders_other)):
            for i, image in enumerate(images or []):
                atomic.write_bytes(aside / RENDERS[other] / f"{i:05d}.png", checked.encode_png(image))


def read_result(
    folder: Path, masks: list[NDArray[np.uint8]] | None = None, appearance: bool = True
) -> Reconstruction | Failure:
    """The reconstruction or failure in a result folder, from any method: bounded, checked, nothing executed.

    `masks` are all part masks, if the caller has read them already. Without `appearance`, gaussians.ply is not read; no
    metric needs it.
    """
    folder = Path(folder)
    header = folder / "prediction.json"
    if not checked.is_there(header):
        raise FreeArtError(f"{folder} is not a result: it has no prediction.json")
    data = checked.read_json(header, SCHEMA, folder)
    seconds = data.get("seconds") or {}
    if not isinstance(seconds, dict) or not all(isinstance(value, int | float) for value in seconds.values()):
        raise FreeArtError(f"{header}: 'seconds' is {seconds!r}, expected a number for every stage")
    seconds = {str(stage): float(value) for stage, value in seconds.items()}
    if data.get("status") == "failed":
        return Failure(checked.text(data, "stage", header), checked.text(data, "reason", header), seconds)
    if data.get("status") != "ok":
        raise FreeArtError(f"{header}: status is {data.get('status')!r}, expected 'ok' or 'failed'")
    states = checked.numbers(data, "states", (None,), header)
    n = len(states)
    if n > MAX_FRAMES:
        raise FreeArtError(f"{header} has {n} states, at most {MAX_FRAMES} are read")
    poses = checked.read_npz(folder / "poses.npz", ("T_camera_reference", "T_camera_moving"), folder)
    std = checked.numbers(data, "state_std", (n,), header, nullable=True) if "state_std" in data else None
    seen = checked.numbers(data, "seen", (n, 2), header).astype(bool) if "seen" in data else np.ones((n, 2), bool)
    return Reconstruction(
        Articulation(
            joint_from_json(data.get("joint"), header),
            *(read_ply(folder / "parts" / f"{name}.ply", folder)[0] for name in PARTS),
        ),
        states,
        poses["T_camera_reference"],
        poses["T_camera_moving"],
        _read_masks(folder, n) if masks is None else np.stack(masks),
        seen,
        std,
        _read_covariances(folder, n),
        seconds,
        trust_from_json(data.get("trust"), header),
        *_read_joint_std(data, header),
        anchor=_read_anchor(data, n, header),
        alternatives=_read_alternatives(data, n, header),
        appearance=read_appearance(folder) if appearance else None,
    )


def read_appearance(folder: Path) -> Gaussians | None:
    """The Gaussians of a result folder, or None without gaussians.ply; raises FreeArtError."""
    path = folder / GAUSSIANS
    return read_gaussians(path, needs_parts=True, root=folder) if checked.is_there(path) else None


def _read_anchor(data: dict[str, Any], n: int, path: Path) -> int:
    """The optional 'anchor' of prediction.json; raises FreeArtError naming `path`."""
    anchor = data.get("anchor", 0)
    if not isinstance(anchor, int) or isinstance(anchor, bool) or not 0 <= anchor < n:
        raise FreeArtError(f"{path}: 'anchor' is {checked.shorten(anchor)}, expected a frame from 0 to {n - 1}")
    return anchor


def _read_joint_std(data: dict[str, Any], path: Path) -> tuple[float | None, float | None]:
    """The optional 'joint_std' of prediction.json: axis, rad, and pivot, metres; raises FreeArtError naming `path`."""
    given = data.get("joint_std")
    if given is None:
        return None, None
    if not isinstance(given, dict):
        raise FreeArtError(f"{path}: 'joint_std' is {checked.shorten(given)}, expected axis_rad and pivot_m")
    axis, pivot = (
        None
        if given.get(name) is None
        else checked.number(given, name, f"{path}: joint_std", 0.0, expected="0 or more, or null")
        for name in ("axis_rad", "pivot_m")
    )
    return axis, pivot


def _alternative_to_json(other: Alternative) -> dict[str, Any]:
    return {"joint": joint_to_json(other.joint), "states": other.states, "cost_difference": other.cost_difference}


def _read_alternatives(data: dict[str, Any], n: int, path: Path) -> tuple[Alternative, ...]:
    """The optional 'alternatives' of prediction.json, each of `n` states; raises FreeArtError naming `path`."""
    given = data.get("alternatives", [])
    if not isinstance(given, list) or len(given) > MAX_ALTERNATIVES or not all(isinstance(a, dict) for a in given):
        raise FreeArtError(
            f"{path}: 'alternatives' is {checked.shorten(given)}, expected at most {MAX_ALTERNATIVES} objects"
        )
    return tuple(
        Alternative(
            joint_from_json(other.get("joint"), path),
            checked.numbers(other, "states", (n,), path),
            checked.number(other, "cost_difference", path),
        )
        for other in given
    )


def _read_masks(folder: Path, n: int) -> NDArray[np.uint8]:
    masks = [checked.read_labels(folder / "part_mask" / f"{i:05d}.png", folder) for i in range(n)]
    for i, mask in enumerate(masks):
        if mask.shape != masks[0].shape or mask.max(initial=0) > 2:
            raise FreeArtError(
                f"{folder}/part_mask/{i:05d}.png has shape {mask.shape} and labels up to {mask.max()}, "
                f"expected {masks[0].shape} and 0, 1, 2"
            )
    return np.stack(masks)


def _read_covariances(folder: Path, n: int) -> NDArray[np.float64] | None:
    path = folder / "poses.npz"
    given = checked.read_npz(path, (), folder, ("covariances",)).get("covariances")
    if given is None:
        return None
    if given.shape != (n, 2, 6, 6) or given.dtype.kind not in "fiu":
        raise FreeArtError(
            f"{path}: covariances has shape {given.shape} {given.dtype}, expected ({n}, 2, 6, 6) numbers"
        )
    covariances = given.astype(float)
    return None if np.isnan(covariances).all() else covariances
