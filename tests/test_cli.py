"""Bad input gives one clear line and exit code 1; nothing is half-written."""

import subprocess
import sys

import pytest

RUN = [sys.executable, "-c", "from freeart21.cli import main; main()"]


def fails(*arguments: object) -> str:
    """Standard error of a command that must end with code 1 and one line."""
    done = subprocess.run([*RUN, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert len(lines) == 1 and lines[0].startswith("freeart21: "), done.stderr
    return lines[0]


def test_an_unknown_object_lists_the_known(tmp_path):
    line = fails("record", "teapot", "--out", tmp_path / "data")
    assert "teapot" in line and all(name in line for name in ("stapler", "drawer_unit", "flip_lighter"))
    assert not (tmp_path / "data").exists()


def test_no_object_lists_the_known(tmp_path):
    assert "stapler" in fails("record", "--out", tmp_path / "data")


def test_a_folder_that_is_no_sequence(tmp_path):
    (tmp_path / "in").mkdir()
    assert "is not a sequence" in fails("reconstruct", tmp_path / "in", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_no_result(tmp_path):
    (tmp_path / "in").mkdir()
    assert "is not a result" in fails("export", tmp_path / "in", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_data_that_is_no_benchmark(tmp_path):
    assert "is not a benchmark" in fails("score", tmp_path, "--data", tmp_path)


def test_an_unknown_protocol_lists_the_known(tmp_path):
    assert "strict-1" in fails("score", tmp_path, "--data", tmp_path, "--protocol", "loose-9")


@pytest.mark.parametrize("name", ["nothing", "."])
def test_a_thing_that_cannot_be_viewed(tmp_path, name):
    (tmp_path / "in").mkdir()
    fails("view", tmp_path / "in" / name, "--out", tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_urdf_without_a_movable_joint_cannot_be_viewed_as_an_asset(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.urdf").write_text('<robot name="a"><link name="base"/></robot>')
    assert "no movable joint" in fails("view", tmp_path / "in", "--out", tmp_path / "page.html")


def test_without_a_vulkan_device_the_recorder_says_so_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nonexistent.json")
    assert "no Vulkan driver is installed" in fails("record", "stapler", "--out", tmp_path / "data", "--frames", "2")
    assert not (tmp_path / "data").exists()


def test_objects_are_listed_as_json():
    import json

    done = subprocess.run([*RUN, "objects", "--json"], capture_output=True, text=True, check=True)
    entries = json.loads(done.stdout)
    assert {"stapler", "drawer_unit", "flip_lighter"} <= {e["name"] for e in entries if e["source"] == "procedural"}
    assert sum(e["source"] == "partnet" for e in entries) == 21
