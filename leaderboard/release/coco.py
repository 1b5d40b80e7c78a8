"""The parts of a data folder's videos as COCO instances (cocodataset.org, data format): one JSON file, no pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import processes
from freeart21.articulation import PARTS
from freeart21.files import atomic
from freeart21.files.benchmark import read_benchmark
from freeart21.files.data_card import describe
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from leaderboard.release.shards import Progress


def write_coco(data: Path, out: Path, progress: Progress = lambda *_: None) -> int:
    """Write `out`/instances.json; gives the number of annotations.

    `file_name` is relative to the data folder. A frame has an annotation for each part that it shows: the visible
    pixels as an uncompressed run-length code, bounding box and area, and the part's pose as an extra. Raises
    FreeArtError without a truth.
    """
    benchmark, facts = read_benchmark(data), describe(data).sequences
    licences = {name: k + 1 for k, name in enumerate(sorted({fact.licence for fact in facts}))}
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for k, fact in enumerate(facts):
        processes.raise_if_stopped()
        truth = read_truth(benchmark.truth(fact.sequence))
        recording = read_sequence(benchmark.sequence(fact.sequence))
        for i in range(len(truth)):
            image = {
                "id": len(images) + 1,
                "file_name": f"sequences/{fact.sequence}/rgb/{i:05d}.png",
                "width": fact.width,
                "height": fact.height,
                "license": licences[fact.licence],
                "sequence": fact.sequence,
                "frame": i,
                "camera_matrix": recording.camera.K,
            }
            images.append(image)
            labels = truth.part_mask(i)
            for part in range(len(PARTS)):
                mask = labels == part + 1
                if mask.any():
                    pose = (truth.Ts_camera_reference, truth.Ts_camera_moving)[part][i]
                    known = {"id": len(annotations) + 1, "image_id": image["id"], "category_id": part + 1}
                    annotations.append({**known, **_instance(mask), "T_camera_part": pose, "state": truth.states[i]})
        progress(f"Read {fact.sequence}", k + 1, len(facts))
    body = {
        "info": {"description": benchmark.name, "version": benchmark.version, "split": benchmark.split},
        "licenses": [{"id": id, "name": name, "url": ""} for name, id in licences.items()],
        "categories": [{"id": k + 1, "name": f"{name} part", "supercategory": "part"} for k, name in enumerate(PARTS)],
        "images": images,
        "annotations": annotations,
    }
    with atomic.new_folder(Path(out)) as new:
        atomic.write_json(new / "instances.json", body)
    return len(annotations)


def _instance(mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    box = [columns[0], rows[0], columns[-1] - columns[0] + 1, rows[-1] - rows[0] + 1]
    code = {"size": list(mask.shape), "counts": run_lengths(mask)}
    return {"segmentation": code, "bbox": [float(v) for v in box], "area": int(mask.sum()), "iscrowd": 0}


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """COCO's run lengths: pixels column by column, off and on in turn, beginning with those that are off."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], ends, [mask.size]])).tolist()
    return counts if len(counts) % 2 == 0 or counts[-1] else counts[:-1]
