"""The statistics of motions, on recordings whose motion is known, and their page."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from synthetic_case import make_recording, make_truth

from freeart21 import se3, sphere
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import write_benchmark
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.recording import Recording
from freeart21.statistics import motion_statistics
from freeart21.truth import Truth
from freeart21.view import page

N = 40
STEPS = np.repeat(["pose", "joint", "both", "none"], [10, 11, 12, 6])


def _known(kind: str = "revolute", swapped: bool = False) -> Truth:
    """40 frames, each step of a known kind: turns of 2.5 degrees, joint moves of 1/25 of the range."""
    base = make_truth(kind)
    joint = base.articulation.joint
    turning, working = np.isin(STEPS, ["pose", "both"]), np.isin(STEPS, ["joint", "both"])
    angle = np.concatenate([[0], np.cumsum(np.radians(2.5) * turning)])
    states = joint.upper * np.concatenate([[0], np.cumsum(working)]) / 25
    Ts = se3.pose(se3.exp_so3(angle[:, None] * [0, 1, 0]), [0, 0, 2.0])
    if swapped:  # the joint's child is the larger part: the reference part is the one that is worked
        joint = dataclasses.replace(joint, axis=-joint.axis)
        Ts = Ts @ se3.inverse(joint.transform(states))
    masks = np.zeros((N, 32, 40), np.uint8)
    masks[:, 6:26, 10:30] = 1  # 20 x 20 of a picture 32 high
    for i in range(N):
        masks[i, 6 : 6 + (0 if 5 <= i < 12 else 10 if i < 30 else 1), 10:29] = 2  # 0, 19 or 190 of 400 pixels
    seen = np.stack([(masks == k).sum((1, 2)) for k in (1, 2)], -1)
    return dataclasses.replace(
        base,
        articulation=dataclasses.replace(base.articulation, joint=joint),
        states=states,
        Ts_camera_reference=Ts,
        Ts_camera_moving=Ts @ joint.transform(states),
        seen=seen,
        part_mask=masks.__getitem__,
        source={"object": "<toy>", "motion": "tumble", "seed": 3},
    )


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("swapped", [False, True])
def test_a_known_motion_gives_its_known_figures(kind: str, swapped: bool) -> None:
    truth = _known(kind, swapped)
    s = motion_statistics(make_recording(truth), truth, every=1)
    assert s.both == 12 / 39
    assert np.median(s.degrees) == pytest.approx(2.5) and s.degrees.max() == pytest.approx(2.5)
    assert s.few_pixels_share == 17 / 40 and s.longest_absence == 7 and s.is_hard
    assert s.range_covered == pytest.approx(23 / 25) and s.depth_m == (1.0, 1.0)


def test_coverage_grows_with_what_is_seen() -> None:
    dots = sphere.fibonacci_sphere(500)
    assert np.allclose(np.linalg.norm(dots, axis=1), 1) and np.abs(dots.mean(0)).max() < 0.01
    assert sphere.coverage(dots) == 1 and sphere.coverage(dots[:250]) < 0.8
    one = sphere.coverage(np.array([[0.0, 0, 1]]))
    assert one == pytest.approx((1 - np.cos(np.radians(30))) / 2, abs=0.02)  # the area of a cap


def _folder(place: Path, names: tuple[str, ...] = ("a", "b")) -> Path:
    for name in names:
        truth = _known()
        recording: Recording = make_recording(truth, name)
        write_sequence(place / "sequences" / name, recording, 1e-4)
        write_truth(place / "truth" / name, truth, 2)
    write_benchmark(place, "toys", "1", "public")
    return place


def test_the_page_of_a_data_folder_tells_all_of_it(tmp_path: Path) -> None:
    text = page(_folder(tmp_path / "toys"))
    assert "2 sequences" in text and "80 frames" in text and "2 of 2 hard" in text
    assert "&lt;toy&gt;" in text and "<toy>" not in text
    assert not re.search(r'(src|href)="(?!data:|#)', text) and text.count("data:image/jpeg") == 2


def test_a_folder_without_truths_is_one_line(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "toys", ("a",))
    for file in sorted((folder / "truth").rglob("*"), reverse=True):
        file.unlink() if file.is_file() else file.rmdir()
    with pytest.raises(FreeArtError, match="1 sequences, but the truth of none"):
        page(folder)
