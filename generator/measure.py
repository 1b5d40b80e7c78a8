"""Turns recordings of the motion 'release' into a measured set: the truth's part poses with a tracker's errors.

It makes test cases of our own for `freeart21 gap`: an effect that acted in the recording is to be found again from the
asset without effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import catalog, se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import write_asset_json
from freeart21.files.asset_copy import copy_urdf
from freeart21.files.measured import write_measured
from freeart21.files.places import check_place
from freeart21.files.truth import read_truth
from freeart21.files.urdf import format_urdf, read_urdf
from freeart21.measured import Measured, Run
from freeart21.se3 import Array
from freeart21.truth import Truth
from generator import partnet, simulate, urdf_object
from generator.object_source import find_object, find_partnet_folder
from generator.release import add_inertia
from generator.settings import RecordSettings

UNCERTAINTY = 0.02
"""Stated relative uncertainty of the asset's inertia and weight, which are the recorder's own."""


@dataclass(frozen=True)
class TrackerNoise:
    """Errors of part poses, correlated over some frames."""

    shift_m: float = 5e-4
    """Standard deviation along each axis."""
    turn_rad: float = 3e-3
    """Standard deviation about each axis, at the moving part's middle."""
    memory: float = 0.8
    """Correlation of the errors of frames next to each other."""
    seed: int = 0

    def errors(self, n: int, take: int) -> Array:
        """(n, 6) twists (v, w)."""
        if not (self.shift_m >= 0 and self.turn_rad >= 0 and 0 <= self.memory < 1 and self.seed >= 0):
            raise FreeArtError(
                f"a tracker's noise of {self.shift_m:g} m and {self.turn_rad:g} rad, memory {self.memory:g}, seed "
                f"{self.seed} is none; expected 0 or more, a memory below 1"
            )
        rng = np.random.default_rng([self.seed, take, 7])
        white = rng.normal(size=(n, 6)) * np.repeat([self.shift_m, self.turn_rad], 3)
        out = white.copy()
        for i in range(1, n):
            out[i] = self.memory * out[i - 1] + np.sqrt(1 - self.memory**2) * white[i]
        return np.asarray(out)


def measure_truths(
    truths: Sequence[Path],
    out: Path,
    noise: TrackerNoise | None = None,
    partnet_root: Path | None = None,
    urdf: Path | None = None,
    root: Path | None = None,
) -> None:
    """Write `out/asset`, the recorded object without effects, and `out/measured`, with one run for each truth.

    With three runs or more the last quarter of them, at least one, is held out. For truths of a URDF, `urdf` is that
    file, and `root` the folder that holds all files that it names. Raises FreeArtError when a truth is not of the
    motion release, or they are not all of one object and joint.
    """
    folders = [Path(folder) for folder in truths]
    check_place(out, None, folders)
    loaded = [read_truth(folder) for folder in folders]
    _check_one_object(folders, loaded)
    with atomic.new_folder(out) as aside:
        asset = _asset(folders[0], loaded[0], aside / "asset", partnet_root, urdf, root)
        runs = [_run(truth, k, noise or TrackerNoise()) for k, truth in enumerate(loaded)]
        spared = max(1, len(runs) // 4) if len(runs) > 2 else 0
        if spared:
            runs = [replace(run, held_out=k >= len(runs) - spared) for k, run in enumerate(runs)]
        fps = float(loaded[0].source["settings"]["fps"])
        kind, gravity = loaded[0].articulation.joint.type, _gravity(folders[0], loaded[0])
        measured = Measured(
            asset.joint, kind, gravity, fps, "recorded", None, None, UNCERTAINTY, UNCERTAINTY, tuple(runs)
        )  # fmt: skip
        write_measured(aside / "measured", measured)


def _check_one_object(folders: list[Path], truths: list[Truth]) -> None:
    if not truths:
        raise FreeArtError("no truth folder was named, expected one or more")
    first: dict[str, Any] = {}
    for folder, truth in zip(folders, truths, strict=True):
        source = truth.source
        settings = source.get("settings") or {}
        if source.get("motion") != "release":
            raise FreeArtError(
                f"{folder} is of the motion '{source.get('motion')}', expected release: only then the base is at rest "
                "and nothing but effects works the joint"
            )
        what = {key: source.get(key) for key in ("object", "joint", "reference_links")}
        what |= {key: settings.get(key) for key in ("seed", "preset", "fps", "effects")}
        first = first or what
        for key, value in what.items():
            if value != first[key]:
                raise FreeArtError(
                    f"{folder} has {key} {value}, but {folders[0]} has {first[key]}: expected one object"
                )


def _gravity(folder: Path, truth: Truth) -> Array:
    """(3,) m/s^2 in the canonical frame of the part at rest.

    That is the reference part, unless it is the one that moves; both frames coincide at state zero.
    """
    world = checked.read_npz(folder / "world.npz", ("T_camera_world",))["T_camera_world"]
    sides = [se3.inverse(world) @ Ts for Ts in (truth.Ts_camera_reference, truth.Ts_camera_moving)]
    still = min(sides, key=lambda Ts: float(np.ptp(Ts, axis=0).max()))
    return np.asarray(still[0, :3, :3].T @ np.array(simulate.GRAVITY))


def _run(truth: Truth, take: int, noise: TrackerNoise) -> Run:
    n = len(truth)
    true = se3.inverse(truth.Ts_camera_reference) @ truth.Ts_camera_moving
    mesh = truth.articulation.moving
    middle = se3.pose(np.eye(3), 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0)))
    shaken = middle @ se3.exp_se3(noise.errors(n, take)) @ se3.inverse(middle)
    seen = np.asarray((truth.seen > 0).all(1))
    times = np.arange(n) / float(truth.source["settings"]["fps"])
    return Run(f"take_{take}", times, np.full(n, np.nan), poses=true @ shaken, seen=seen)


def _asset(
    folder: Path, truth: Truth, out: Path, partnet_root: Path | None, urdf: Path | None, root: Path | None
) -> Asset:
    """The object with the inertia of its release and without effects, in the truth's frames."""
    source = truth.source
    own = source.get("object_source") == "procedural"
    joint, skip_missing = str(source["joint"]), bool(source["settings"].get("skip_missing"))
    if source.get("object_source") == "urdf":
        given = _check_urdf(folder, truth, urdf, root)
        loaded = urdf_object.load_urdf(given, joint, skip_missing, root)
        copy_urdf(given, out, loaded.asset.root, skip_missing)
        read = read_urdf(out / given.name)  # a released joint has the effects of the recording and no others
        joints = {name: replace(joint, damping=0.0, friction=0.0) for name, joint in read.joints.items()}
        atomic.write_bytes(read.path, format_urdf(replace(read, joints=joints)))
        loaded = urdf_object.load_urdf(read.path, joint, skip_missing, out)
    elif urdf is not None:
        raise FreeArtError(f"{folder} is of {source['object']}, which was not recorded from a URDF; got {urdf}")
    else:
        checked.copy_folder(folder / "object" if own else find_partnet_folder(str(source["object"]), partnet_root), out)
        loaded = partnet.load(out, joint, skip_missing=skip_missing)
    asset = loaded.asset
    if own:
        entry = catalog.find(str(source["object"]), partnet=False)
        settings = RecordSettings(seed=int(source["settings"]["seed"]), preset=str(source["settings"]["preset"]))
        asset = add_inertia(asset, find_object(entry.name, settings).build(), out, shapes=True)
        Path(asset.urdf).replace(out / partnet.URDF_NAME)
        asset = replace(asset, urdf=out / partnet.URDF_NAME)
    if asset.reference_link not in source["reference_links"]:  # the child side is the reference part
        simulated = simulate.load(asset, gravity=(0.0, 0.0, 0.0))
        simulated.set_state(0.0)
        T = se3.inverse(simulated.link_pose(asset.reference_link)) @ simulated.link_pose(asset.moving_link)
        asset = replace(
            asset,
            reference_link=asset.moving_link,
            moving_link=asset.reference_link,
            T_canonical_reference=asset.T_canonical_reference @ T,
        )
    asset = replace(asset, source={**asset.source, "recorded": str(source["object"])})
    write_asset_json(out, asset)
    return asset


def _check_urdf(folder: Path, truth: Truth, urdf: Path | None, root: Path | None) -> Path:
    """Return `urdf`; FreeArtError unless it is the recorded file."""
    name = truth.source["object"]
    if urdf is None:
        raise FreeArtError(f"{folder} is of the URDF {name}; a truth holds its hash, not its files: give it as --urdf")
    was, now = (truth.source["settings"].get("urdf") or {}).get("sha256"), urdf_object.digest(urdf, root)
    if was != now:
        raise FreeArtError(
            f"{urdf} is not the object of {folder}: it and its meshes have SHA-256 {now[:12]}..., expected "
            f"{str(was)[:12]}..."
        )
    return urdf
