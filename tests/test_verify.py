"""`freeart21 verify` finds whatever was changed, missing, added, or does not fit together."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import run_command
from refusal import assert_refused

from freeart21 import se3
from freeart21.files.benchmark import write_benchmark
from freeart21.files.data_card import CARD_FILES
from freeart21.files.verify import verify
from generator.dataset import plan_jobs, record_jobs
from generator.golden import verify_deep
from generator.session import RecordSettings

SETTINGS = RecordSettings(frames=4, width=240, height=136, queries=2, shader="trivial", edge=0.2)
SEQUENCE, TRUTH = Path("sequences/flip_lighter-s0"), Path("truth/flip_lighter-s0")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = tmp_path_factory.mktemp("sound") / "data"
    record_jobs(data, plan_jobs(["flip_lighter"], SETTINGS))
    return data


@pytest.fixture
def data(sound: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sound, tmp_path / "data"))


def rehashed(data: Path) -> Path:
    """The folder with a benchmark.json that fits its files, so that only their content can be wrong."""
    write_benchmark(data, "data", "1", "public")
    return data


def change_json(path: Path, change: Callable[[dict], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def change_arrays(path: Path, change: Callable[[dict[str, np.ndarray]], object]) -> None:
    with np.load(path) as stored:
        arrays = {name: stored[name].copy() for name in stored}
    change(arrays)
    np.savez_compressed(path, **arrays)


def change_picture(path: Path, change: Callable[[np.ndarray], object]) -> None:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    change(image)
    cv2.imwrite(str(path), image)


def test_a_sound_data_set_has_no_findings(sound: Path) -> None:
    report = verify(sound)
    assert report.findings == [] and report.sequences == 1
    assert report.files == sum(1 for p in sound.rglob("*") if p.is_file() and p.name not in CARD_FILES) - 1


# --- files ------------------------------------------------------------------------------------------------------------


def test_one_flipped_bit_in_any_kind_of_file_is_found(data: Path) -> None:
    kinds = {(path.suffix, path.parent.name): path for path in (data / "sequences").rglob("*") if path.is_file()}
    kinds |= {(path.suffix, path.parent.name): path for path in (data / "truth").rglob("*") if path.is_file()}
    assert len(kinds) > 12
    for path in kinds.values():
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(bytes(content))
        changed = [f for f in verify(data).findings if f.startswith(str(path)) and "SHA-256" in f]
        assert len(changed) == 1, path
        content[len(content) // 2] ^= 1
        path.write_bytes(bytes(content))
    assert verify(data).findings == []


def test_files_that_are_missing_or_not_listed_are_found(data: Path) -> None:
    (data / SEQUENCE / "depth" / "00002.png").unlink()
    (data / TRUTH / "notes.txt").write_text("hm")
    (data / ".recording").mkdir()
    (data / ".recording" / "lock").touch()
    findings = verify(data).findings
    for message in (
        "00002.png is missing: benchmark",
        "notes.txt is not listed",
        "lock is not listed",
        "frame 2 is missing",
    ):
        assert any(message in finding for finding in findings), message


def test_a_link_in_place_of_a_file_is_found(data: Path, tmp_path: Path) -> None:
    path = data / SEQUENCE / "rgb" / "00000.png"
    path.rename(tmp_path / "elsewhere.png")
    path.symlink_to(tmp_path / "elsewhere.png")
    assert any("is not a plain file" in finding for finding in verify(data).findings)


def test_a_folder_without_or_with_a_broken_list_is_one_line(data: Path, tmp_path: Path) -> None:
    assert_refused("is not a benchmark", verify, tmp_path)
    change_json(data / "benchmark.json", lambda c: c.update(sha256=[]))
    assert_refused("'sha256' is list", verify, data)


# --- what they say ----------------------------------------------------------------------------------------------------


def _turn_moving(arrays: dict[str, np.ndarray]) -> None:
    arrays["T_camera_moving"][1] = arrays["T_camera_moving"][1] @ se3.exp_se3(np.array([0, 0, 0, 0, 1e-4, 0]))


def _shear(arrays: dict[str, np.ndarray]) -> None:
    arrays["T_camera_reference"][2, 0, 0] += 0.1


def _erase(image: np.ndarray) -> None:
    image[image > 0] = 0


def _one_stray(image: np.ndarray) -> None:
    image[0, 0] = image.max()


def _second_part_as_first(image: np.ndarray) -> None:
    image[image == 2] = 1


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "moving pose": (
        lambda d: change_arrays(d / TRUTH / "poses.npz", _turn_moving),
        "moving part's pose of frame 1 differs by .* from that of joint and state",
    ),
    "pose not rigid": (
        lambda d: change_arrays(d / TRUTH / "poses.npz", _shear),
        "flip_lighter-s0: truth Ts_camera_reference.2. is not a rigid pose",
    ),
    "state beyond limits": (
        lambda d: change_json(d / TRUTH / "truth.json", lambda c: c["states"].__setitem__(3, 9.0)),
        "the state of frame 3 is 9 rad, expected 0 to 2.2",
    ),
    "seen": (
        lambda d: change_arrays(d / TRUTH / "seen.npz", lambda a: a["seen"].__setitem__((0, 0), 5)),
        r"seen.npz says \[5, \d+\] of frame 0, its part_mask shows",
    ),
    "mask": (lambda d: change_picture(d / SEQUENCE / "mask" / "00001.png", _erase), "00001.png differs in .* pixels"),
    "part mask": (
        lambda d: change_picture(d / TRUTH / "part_mask" / "00001.png", _second_part_as_first),
        "of frame 1, its part_mask shows",
    ),
    "depth outside": (
        lambda d: change_picture(d / SEQUENCE / "depth" / "00000.png", _one_stray),
        "depth at 1 pixels outside the mask",
    ),
    "no depth": (lambda d: change_picture(d / SEQUENCE / "depth" / "00003.png", _erase), "no depth at .* pixels"),
    "one frame too many": (
        lambda d: shutil.copy(d / SEQUENCE / "rgb" / "00000.png", d / SEQUENCE / "rgb" / "00004.png"),
        "rgb holds 5 files, expected 4",
    ),
    "an empty view": (
        lambda d: change_picture(d / TRUTH / "queries/mask/00000.png", _erase),
        "00000.png shows nothing",
    ),
    "a view too few": (
        lambda d: change_json(d / SEQUENCE / "queries.json", lambda c: c["queries"].pop()),
        "expected 1",
    ),
    "the seed in the video's header": (
        lambda d: change_json(d / SEQUENCE / "sequence.json", lambda c: c.update(seed=3)),
        "says 'seed', which methods are not to see",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_contents_that_do_not_fit_together_are_found(data: Path, fault: str) -> None:
    spoil, message = FAULTS[fault]
    spoil(data)
    findings = verify(rehashed(data)).findings
    assert any(re.search(message, finding) for finding in findings), findings
    assert all("\n" not in finding for finding in findings)


# --- the command, and the deep look -----------------------------------------------------------------------------------


def test_the_command_prints_a_line_a_finding_and_ends_with_1(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_command(capsys, "verify", data)
    assert code == 0 and "1 sequences: all well" in out
    (data / SEQUENCE / "rgb" / "00000.png").unlink()
    code, out, _ = run_command(capsys, "verify", data)
    assert code == 1 and "00000.png is missing" in out and "all well" not in out


def _shift_all(arrays: dict[str, np.ndarray]) -> None:
    for Ts in arrays.values():
        Ts[:, 2, 3] += 0.001  # along the view: the masks hardly change, the depth does


def test_the_deep_look_finds_a_truth_that_fits_itself_but_not_the_pictures(data: Path) -> None:
    assert verify_deep(data) == []
    change_arrays(data / TRUTH / "poses.npz", _shift_all)
    assert verify(rehashed(data)).findings == []
    findings = verify_deep(data)
    assert any("off what rays meet" in finding for finding in findings)
