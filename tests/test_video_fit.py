"""Parts that do not lie on the object of the video: said with what would put them there, never of honest ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from perturbed import (
    KINDS,
    in_millimetres,
    opengl,
    other_type,
    reversed_axis,
    shifted,
    tilted,
    with_poses,
)
from synthetic_case import (
    HEIGHT,
    WIDTH,
    in_frame,
    make_truth,
    noisy_answer,
    random_pose,
    static_answer,
    truth_as_answer,
)

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.files.benchmark import write_benchmark
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.sequence import write_sequence
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Frame, Recording
from freeart21.truth import Truth
from generator.rays import Caster
from leaderboard.validate import validate_results
from leaderboard.video_fit import describe_misfit


def filmed(truth: Truth, holes: float = 0.0) -> Recording:
    """The truth as a camera sees it: masks and depth by rays; `holes` is the share of pixels without depth."""
    camera = Camera.from_fov(WIDTH, HEIGHT, 0.6)
    caster = Caster((truth.articulation.reference, truth.articulation.moving))

    def load(i: int) -> Frame:
        hits = caster.look(camera, (truth.Ts_camera_reference[i], truth.Ts_camera_moving[i]))
        mask = (hits.side >= 0).reshape(HEIGHT, WIDTH)
        depth = np.where(mask, hits.distance.reshape(HEIGHT, WIDTH), 0)
        depth[np.random.default_rng(i).random(mask.shape) < holes] = 0
        return Frame(np.zeros((HEIGHT, WIDTH, 3), np.uint8), depth.astype(np.float32), mask)

    return Recording(camera, np.arange(len(truth)) / 30, load, name="sequence")


HONEST: dict[str, Callable[[Truth], Reconstruction]] = {
    "truth": truth_as_answer,
    "noisy": noisy_answer,
    "still": static_answer,
    "tilted": lambda truth: tilted(truth, 20),
    "shifted": lambda truth: shifted(truth, 0.05),
    "reversed": reversed_axis,
    "other_type": other_type,
    "other_frame": lambda truth: in_frame(truth_as_answer(truth), random_pose(np.random.default_rng(3))),
}
WRONG: dict[str, tuple[Callable[[Truth], Reconstruction], str]] = {
    "opengl": (lambda truth: with_poses(truth, opengl), "if the poses were in OpenGL's camera axes"),
    "inverse": (lambda truth: with_poses(truth, se3.inverse), "if the poses were camera to object"),
    "mm": (in_millimetres, r"if lengths were in mm (import --scale 0.001)"),
    "opengl_mm": (
        lambda truth: replace(
            in_millimetres(truth),
            Ts_camera_reference=opengl(in_millimetres(truth).Ts_camera_reference),
            Ts_camera_moving=opengl(in_millimetres(truth).Ts_camera_moving),
        ),
        "OpenGL's camera axes (import --axes or --frame, where the layout has one) and lengths were in mm",
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", HONEST)
def test_nothing_is_said_of_parts_on_the_object(name: str, kind: str) -> None:
    truth = make_truth(kind)
    assert describe_misfit(HONEST[name](truth), filmed(truth)) == ""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", WRONG)
def test_what_would_put_parts_on_the_object_is_named(name: str, kind: str) -> None:
    truth = make_truth(kind)
    make, words = WRONG[name]
    for holes in (0.0, 0.5):
        sentence = describe_misfit(make(truth), filmed(truth, holes))
        assert words in sentence and "\n" not in sentence, sentence


def test_a_place_that_nothing_explains_is_said_without_a_guess() -> None:
    truth = make_truth()
    aside = se3.pose(np.eye(3), [0.5, 0.3, 0])
    sentence = describe_misfit(with_poses(truth, lambda Ts: aside @ Ts), filmed(truth))
    assert sentence.endswith("none of the other axes and units fits")


def test_what_a_method_lacks_is_not_looked_at() -> None:
    truth = make_truth()
    wrong = with_poses(truth, opengl)
    assert describe_misfit(wrong, filmed(truth), ("meshes",)) == ""
    one = replace(truth_as_answer(truth), Ts_camera_moving=wrong.Ts_camera_moving, anchor=3)
    assert describe_misfit(one, filmed(truth), ("poses",)) == "", "the moving part follows joint and states then"
    assert "(frames 3)" in describe_misfit(replace(wrong, anchor=3), filmed(truth), ("poses",))


def test_validate_says_it_and_passes(tmp_path) -> None:
    truth = make_truth()
    write_sequence(tmp_path / "data/sequences/lid", filmed(truth), 1e-4)
    write_benchmark(tmp_path / "data", "made-up", "1", "test")
    write_result(tmp_path / "results/lid", with_poses(truth, opengl))
    write_method(tmp_path / "results", Method("mine"))
    report = validate_results(tmp_path / "results", tmp_path / "data")
    assert not report.faults
    assert any(note.startswith("lid: the parts") and "OpenGL's camera axes" in note for note in report.notes)
    (tmp_path / "data/sequences/lid/mask/00000.png").write_bytes(b"")
    report = validate_results(tmp_path / "results", tmp_path / "data")
    assert not report.faults and any("is not known" in note and "00000.png" in note for note in report.notes)
