"""Checks a data folder against its truth, independently of the recorder.

- Depth and part masks of some frames are compared with rays (Embree) against the truth's meshes at the truth's poses.
- The held-out views are rendered again from the object's URDF in the truth folder, posed by the truth.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.files.verify import collect_findings
from freeart21.recording import Recording
from freeart21.truth import Truth
from generator import partnet
from generator.rays import Caster
from generator.scene import Picture, Scene
from generator.sensors import SENSORS

DEPTH_SHARE = 0.002
"""Largest depth error away from edges, as a share of the object's diagonal."""
ODD_PIXELS = 0.005
"""Largest share of pixels with a larger error: edges within a part, which the part mask does not show."""
LEAST_PSNR = 35.0
"""Least PSNR of a held-out view that is rendered again, dB, inside its mask."""


def verify_deep(data: Path, frames: int = 5, views: int = 5, hidden_truth: Path | None = None) -> list[str]:
    """Findings on the data folder `data`, one line each, from `frames` frames and `views` views of every sequence.

    Depth is compared where the sensor was clean. Views are rendered again where the truth holds the object's files,
    which it does not for PartNet-Mobility. `hidden_truth` is that of a packed folder. What cannot be read, or rendered
    on this machine, is a finding, too. Raises FreeArtError when there is no readable benchmark.json.
    """
    benchmark = read_benchmark(Path(data), hidden_truth)
    findings: list[str] = []
    for name in benchmark.sequences:
        findings += collect_findings(partial(_deep_findings, benchmark, name, frames, views))
    return findings


def _deep_findings(benchmark: Benchmark, name: str, frames: int, views: int) -> Iterator[str]:
    recording, truth = read_sequence(benchmark.sequence(name)), read_truth(benchmark.truth(name))
    yield from collect_findings(lambda: cast_findings(name, recording, truth, frames))
    if (benchmark.truth(name) / "object").is_dir():
        psnrs = [value for _, value in render_again(recording, truth, benchmark.truth(name), views)]
        for i in np.flatnonzero(np.array(psnrs) < LEAST_PSNR):
            yield (
                f"{name}: view {i}, rendered anew from truth/{name}/object, has {psnrs[i]:.1f} dB, expected "
                f"{LEAST_PSNR:g}"
            )


def cast_findings(name: str, recording: Recording, truth: Truth, frames: int) -> Iterator[str]:
    """Findings on depth and masks of `frames` frames, spread evenly over the video."""
    sensors = set(str(truth.source.get("sensor", "clean")).split("+"))
    caster = Caster((truth.articulation.reference, truth.articulation.moving))
    for i in np.unique(np.linspace(0, len(truth) - 1, frames).astype(int)):
        hits = caster.look(recording.camera, (truth.Ts_camera_reference[i], truth.Ts_camera_moving[i]))
        part_mask, frame = truth.part_mask(int(i)), recording.frame(int(i))
        labels = (hits.side + 1).reshape(part_mask.shape)
        wrong = labels != part_mask
        if any(name in SENSORS and SENSORS[name].occludes for name in sensors):  # it may hide what the rays meet
            wrong &= part_mask > 0
        share = wrong.sum() / max(int((part_mask > 0).sum()), 1)
        if share > 0.01:
            yield f"{name}: in frame {i} {100 * share:.1f} % of the pixels show another part than rays meet"
        if "clean" not in sensors:
            continue
        flat = interior_pixels(part_mask) & interior_pixels(labels) & (labels == part_mask) & frame.mask
        error = np.abs(hits.distance.reshape(part_mask.shape)[flat] - frame.depth[flat])
        odd = float(np.mean(error > DEPTH_SHARE * truth.diagonal)) if flat.any() else 0.0
        if odd > ODD_PIXELS:
            yield (
                f"{name}: in frame {i} the depth of {100 * odd:.1f} % of the pixels away from edges is more than "
                f"{100 * DEPTH_SHARE:g} % of the diagonal off what rays meet"
            )


def render_again(recording: Recording, truth: Truth, folder: Path, views: int) -> Iterator[tuple[Picture, float]]:
    """Render the first `views` held-out views from the object in the truth's `folder`; with PSNR, dB, in the mask."""
    source = truth.source
    loaded = partnet.load(folder / "object", source.get("joint"))
    parent_is_reference = loaded.asset.reference_link in source.get("reference_links", ())
    Ts_camera_world = checked.read_npz(folder / "world.npz", ("T_camera_world",))["T_camera_world"]
    if Ts_camera_world.shape != truth.Ts_camera_reference.shape:
        raise FreeArtError(f"{folder}/world.npz has shape {Ts_camera_world.shape}, expected a pose a frame")
    shader, groups = str(source.get("shader", "default")), [side.links for side in loaded.sides]
    reach = float(np.linalg.norm(truth.Ts_camera_reference[:, :3, 3], axis=1).max()) + 4 * truth.diagonal
    scene = Scene(loaded.asset.urdf, groups, recording.camera, 1e-3 * reach, reach, shader)
    scene.fix_lamps(Ts_camera_world[0])
    for i, query in enumerate(recording.queries[:views]):
        T, state = (
            query.T_newcam_cam @ truth.Ts_camera_reference[query.pose_of_frame],
            truth.states[query.state_of_frame],
        )
        if not parent_is_reference:
            T = T @ truth.articulation.joint.transform(state)
        positions = {**loaded.asset.held, loaded.joint.name: float(state)}
        picture = scene.render(T, positions, query.T_newcam_cam @ Ts_camera_world[query.pose_of_frame])
        yield picture, psnr(picture.rgb, truth.query_rgb(i), truth.query_mask(i))


def psnr(rgb: NDArray[np.uint8], expected: NDArray[np.uint8], mask: NDArray[np.bool_]) -> float:
    """Peak signal-to-noise ratio, dB, over the pixels of `mask` (h, w); infinite for equal pictures."""
    error = (rgb[mask].astype(float) - expected[mask].astype(float)) ** 2
    mean = float(error.mean()) if error.size else 0.0
    return float(np.inf) if mean == 0 else float(10 * np.log10(255**2 / mean))


def interior_pixels(labels: NDArray[Any]) -> NDArray[np.bool_]:
    """(h, w) pixels whose eight neighbours have the same label."""
    same = np.ones(labels.shape, bool)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            same &= np.roll(labels, (dv, du), (0, 1)) == labels
    return same
