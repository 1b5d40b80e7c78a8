"""Bad input gives one clear line and exit code 1; nothing is written."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

RUN = [sys.executable, "-c", "from freeart21.cli import main; main()"]


def fails(*arguments: object) -> str:
    """Standard error of a command that must end with code 1 and one line."""
    done = subprocess.run([*RUN, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert len(lines) == 1 and lines[0].startswith("freeart21: "), done.stderr
    return lines[0]


OUT = ("--out", "{tmp}/out")
BAD = {
    "an unknown object": (("record", "teapot", *OUT), ("teapot", "stapler", "drawer_unit", "flip_lighter")),
    "no object": (("record", *OUT), ("stapler",)),
    "no sequence": (("reconstruct", "{tmp}/in", *OUT), ("is not a sequence",)),
    "no result": (("export", "{tmp}/in", *OUT), ("is not a result",)),
    "no benchmark": (("score", "{tmp}", "--data", "{tmp}"), ("is not a benchmark",)),
    "an unknown protocol": (("score", "{tmp}", "--data", "{tmp}", "--protocol", "loose-9"), ("strict-1",)),
    "nothing to view": (("view", "{tmp}/in/nothing", *OUT), ()),
    "an empty folder to view": (("view", "{tmp}/in", *OUT), ()),
    "no movable joint": (("view", "{tmp}/urdf", *OUT), ("no movable joint",)),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_writes_nothing(tmp_path: Path, case: str) -> None:
    arguments, words = BAD[case]
    (tmp_path / "in").mkdir()
    (tmp_path / "urdf").mkdir()
    (tmp_path / "urdf" / "a.urdf").write_text('<robot name="a"><link name="base"/></robot>')
    line = fails(*(str(argument).replace("{tmp}", str(tmp_path)) for argument in arguments))
    assert all(word in line for word in words), line
    assert not (tmp_path / "out").exists()


def test_recording_without_a_vulkan_device_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nonexistent.json")
    assert "no Vulkan driver" in fails("record", "stapler", "--out", tmp_path / "data", "--frames", "2")
    assert not (tmp_path / "data").exists()


def test_objects_are_listed_as_json() -> None:
    done = subprocess.run([*RUN, "objects", "--json"], capture_output=True, text=True, check=True)
    entries = json.loads(done.stdout)
    assert {"stapler", "drawer_unit", "flip_lighter"} <= {e["name"] for e in entries if e["source"] == "procedural"}
    assert sum(e["source"] == "partnet" for e in entries) == 21
