"""`film`: from a camera's recording to an asset by one command that says what it needs and keeps what is finished."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import run_command
from score_files import write_data

from freeart21.files.result import write_result
from freeart21.reconstruction import Failure

CAMERA = Path(__file__).resolve().parents[2] / "shared" / "rgbd" / "record3d"


def write_pictures(folder: Path, n: int = 12, masks: bool = False) -> Path:
    """A picture folder as a camera writes it: a bright disc that moves over a table, 60 by 80 pixels."""
    for sub in ("rgb", "depth", *(["masks"] if masks else [])):
        (folder / sub).mkdir(parents=True)
    (folder / "cam_K.txt").write_text("70 0 40\n0 70 30\n0 0 1\n")
    row, column = np.indices((60, 80))
    for i in range(n):
        disc = np.hypot(row - 30, column - 40 - i) < 15
        rgb = np.where(disc[..., None], (60, 120, 200), 30).astype(np.uint8)
        cv2.imwrite(str(folder / "rgb" / f"{i:05d}.png"), rgb)
        cv2.imwrite(str(folder / "depth" / f"{i:05d}.png"), np.where(disc, 400, 900).astype(np.uint16))
        if masks:
            cv2.imwrite(str(folder / "masks" / f"{i:05d}.png"), 255 * disc.astype(np.uint8))
    return folder


def test_without_masks_it_writes_the_pictures_to_segment_and_says_so(tmp_path: Path, capsys):
    source, out = write_pictures(tmp_path / "lid"), tmp_path / "out"
    for _ in range(2):  # the second time nothing is written anew
        code, _, err = run_command(capsys, "film", source, "--out", out)
        assert code == 1 and err.count("\n") == 1 and "--masks" in err and f"the pictures of {source}" in err
    assert not out.exists()


def test_pictures_of_a_camera_are_written_once(tmp_path: Path, capsys):
    if not CAMERA.is_dir():
        pytest.skip("shared/rgbd is not at hand")
    out = tmp_path / "out"
    for _ in range(2):
        code, _, err = run_command(capsys, "film", CAMERA, "--out", out)
        assert code == 1 and "by --masks" in err.splitlines()[-1] and str(out / "data" / "pictures") in err
    assert len(list((out / "data" / "pictures" / "record3d" / "rgb").iterdir())) > 1
    assert not (out / "data" / "sequences").exists() and not (out / "result").exists()


def test_a_bad_video_is_not_solved(tmp_path: Path, capsys):
    source, out = write_pictures(tmp_path / "lid", n=3, masks=True), tmp_path / "out"
    code, shown, err = run_command(capsys, "film", source, "--out", out)
    assert code == 1 and "bad   frames: 3" in shown and "--anyway" in err
    assert (out / "look.html").is_file() and not (out / "result").exists()
    code, _, again = run_command(capsys, "film", source, "--out", out)  # the sequence stays, and is not converted again
    assert code == 1 and again == err.splitlines(keepends=True)[-1]


def test_a_finished_result_stays_and_its_failure_is_one_line(tmp_path: Path, capsys):
    data = write_data(tmp_path / "data")
    write_result(tmp_path / "out" / "result", Failure("segmentation", "nothing moves"))
    before = (tmp_path / "out" / "result" / "prediction.json").read_bytes()
    code, shown, err = run_command(capsys, "film", data / "sequences" / "a", "--out", tmp_path / "out", "--anyway")
    assert code == 1 and "nothing moves" in err and "is finished; remove it to solve anew" in shown
    assert (tmp_path / "out" / "result" / "prediction.json").read_bytes() == before


@pytest.mark.parametrize("found", [0, 2])
def test_a_source_of_no_or_several_recordings_is_refused(found: int, tmp_path: Path, capsys):
    for k in range(found):
        write_pictures(tmp_path / "takes" / f"take{k}", masks=True)
    (tmp_path / "takes").mkdir(exist_ok=True)
    code, _, err = run_command(capsys, "film", tmp_path / "takes", "--out", tmp_path / "out")
    assert code == 1 and re.search("expected one|no known layout|holds no", err), err
