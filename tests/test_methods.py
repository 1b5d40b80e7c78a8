"""`freeart21 run`: methods as commands and containers, measured, within limits, their output read as a stranger's."""

import json
import os
import shutil
import stat
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from adapters_case import truth_of
from command_line import run_command
from refusal import assert_refused
from score_files import score_one

from freeart21.files.result import read_method, read_result, write_result
from freeart21.reconstruction import Failure
from leaderboard.adapters.layout import layouts
from leaderboard.methods.descriptor import (
    NATIVE,
    SCHEMA,
    Descriptor,
    Limits,
    find_descriptor,
    shipped,
)
from leaderboard.methods.run import contain, run_method
from leaderboard.validate import validate_results

SOLVE = """
import sys, pathlib, shutil
sequence, out = map(pathlib.Path, sys.argv[1:3])
assert (sequence / "sequence.json").is_file() and not (sequence / "truth").exists()
shutil.copytree(pathlib.Path({answers!r}) / sequence.name, out / "result")
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """The truth as result folders: what stand-ins of native methods copy."""
    from synthetic_case import truth_as_answer

    folder = tmp_path_factory.mktemp("answers")
    for name in "abc":
        write_result(folder / name, truth_as_answer(truth_of(name)))
    return folder


def method(code: str, *words, inputs=("sequence",), **more) -> Descriptor:
    """A method that is a Python program."""
    given = {"result": "result", **more}
    return Descriptor(SCHEMA, "mine", "here", (("{python}", "-c", code, *words),), inputs, **given)


def native(answers, code="", **more) -> Descriptor:
    return method(SOLVE.format(answers=str(answers)) + code, "{sequence}", "{out}", **more)


def failure(out, name="a") -> str:
    answer = read_result(out / name)
    assert isinstance(answer, Failure), answer
    return f"{answer.stage}: {answer.reason}"


def test_a_native_method_is_measured_and_its_results_are_valid(data, tmp_path, answers):
    busy = (
        "x = bytearray(200_000_000)\nimport time\nt = time.process_time()\nwhile time.process_time() < t + 0.5: pass\n"
    )
    ours = b"x" * 2_000_000_000  # resident in the process that starts it: not the method's
    report = run_method(native(answers, busy), data, tmp_path / "r", sequences=("a", "b"))
    del ours
    for entry in report.entries.values():
        assert entry.outcome == "answer" and entry.cpu_seconds >= 0.5 and entry.seconds >= 0.5
        assert 2e8 < entry.peak_bytes < 1.2e9
    assert [str(f) for f in validate_results(tmp_path / "r", data).faults] == [
        "c is missing, expected a folder with prediction.json"
    ]
    assert read_method(tmp_path / "r").name == "mine" and read_method(tmp_path / "r").lacks == ()
    assert score_one(data, tmp_path / "r" / "a").status == "ok"
    assert sorted(p.name for p in (tmp_path / "r").iterdir() if p.name[0] != ".") == [
        "a",
        "b",
        "method.json",
        "run.json",
    ]


def test_a_run_goes_on_and_another_descriptor_is_refused(data, tmp_path, answers):
    count = tmp_path / "count"
    mine = native(answers, f"open({str(count)!r}, 'a').write(sequence.name)\n")
    run_method(mine, data, tmp_path / "r", sequences=("a",))
    report = run_method(mine, data, tmp_path / "r")
    assert report.skipped == ("a",) and count.read_text() == "abc"
    shutil.rmtree(tmp_path / "r" / "b")
    run_method(mine, data, tmp_path / "r")
    assert count.read_text() == "abcb"
    assert_refused("another descriptor", run_method, replace(mine, code="elsewhere"), data, tmp_path / "r")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    assert_refused("not a run of a method", run_method, mine, data, tmp_path / "other")
    assert_refused("has no sequence 'd'", run_method, mine, data, tmp_path / "s", sequences=("d",))


def test_limits_of_time_and_memory_end_all_its_processes(data, tmp_path):
    mark = f"stand-in {os.getpid()}"
    child = f"[sys.executable, '-c', 'import time; time.sleep(60)', {mark!r}]"
    forks = f"import subprocess, sys, time\nsubprocess.Popen({child})\ntime.sleep(60)"
    slow = method(forks, limits=Limits(1.0, 8.0))
    run_method(slow, data, tmp_path / "slow", sequences=("a",))
    assert failure(tmp_path / "slow") == "limits: it took more than 1 s"
    left = [p for p in Path("/proc").glob("[0-9]*/cmdline") if mark.encode() in _read(p)]
    assert not left
    large = method("x = bytearray(400_000_000)\nimport time\ntime.sleep(60)", limits=Limits(60.0, 0.3))
    run_method(large, data, tmp_path / "large", sequences=("a",))
    assert failure(tmp_path / "large") == "limits: it took more than 0.3 GB of memory"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


@pytest.mark.parametrize(
    "code, expected",
    [
        ("raise SystemExit('no depth')", "exit code 1: 'no depth'"),
        ("pass", "output: the method wrote no folder result"),
        ("import os, sys; os.mkdir(sys.argv[1] + '/result')", "is not a result: it has no prediction.json"),
        ("import os, sys; os.symlink('/etc', sys.argv[1] + '/result')", "output: "),
    ],
)
def test_what_a_method_does_wrong_is_a_declared_failure(data, tmp_path, code, expected):
    report = run_method(method(code, "{out}"), data, tmp_path / "r", sequences=("a",))
    assert report.entries["a"].outcome == "failure" and expected in failure(tmp_path / "r")


def test_output_that_leads_elsewhere_or_is_of_another_video_is_refused(data, tmp_path, answers):
    leak = native(answers, "(out / 'result' / 'renders').symlink_to('/etc')\n")
    run_method(leak, data, tmp_path / "r", sequences=("a",))
    assert "output: " in failure(tmp_path / "r")
    junk = native(answers, "(out / 'result' / 'virus.sh').write_text('x')\n")
    run_method(junk, data, tmp_path / "j", sequences=("a",))
    assert not (tmp_path / "j" / "a" / "virus.sh").exists() and not isinstance(
        read_result(tmp_path / "j" / "a"), Failure
    )


def test_words_never_meet_a_shell(data, tmp_path):
    """Names and words with shell's signs arrive as they are; what is put in is not filled again."""
    witness = tmp_path / "got.json"
    code = f"import json, sys; json.dump(sys.argv[1:], open({str(witness)!r}, 'w'))"
    home = tmp_path / "a; touch {out} $(id)"
    home.mkdir()
    run_method(method(code, "{home}", "$HOME; `id`", "{name}"), data, tmp_path / "r", home, ("a",))
    assert json.loads(witness.read_text()) == [str(home), "$HOME; `id`", "a"]


def test_a_container_sees_its_inputs_alone(data, tmp_path, answers):
    mine = replace(native(answers), image="them/theirs:1", gpu=True)
    values = {"sequence": data / "sequences" / "a", "out": tmp_path / "o", "name": "a", "home": None}
    line = contain(mine, ["solve", "{sequence}", "{out}"], values, "docker", "box")
    assert line[line.index("--network") + 1] == "none" and line[-4:] == [
        "them/theirs:1",
        "solve",
        "/freeart21/sequence",
        "/freeart21/out",
    ]
    mounts = [line[i + 1] for i, word in enumerate(line) if word == "--mount"]
    assert [m.split(",")[-1] for m in mounts] == ["readonly", "target=/freeart21/out"] and len(mounts) == 2
    assert not any("truth" in word for word in line) and "--gpus" in line


def test_a_container_is_run_and_killed_at_the_limit(data, tmp_path, monkeypatch):
    """A stand-in for docker notes how it was called."""
    calls = tmp_path / "calls"
    docker = tmp_path / "bin" / "docker"
    docker.parent.mkdir()
    docker.write_text(f'#!/bin/sh\necho "$1 $4" >> {calls}\ntest "$1" = kill || exec sleep 30\n')
    docker.chmod(docker.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{docker.parent}:{os.environ['PATH']}")
    mine = replace(method("pass"), image="them/theirs:1", limits=Limits(1.0, 8.0))
    run_method(mine, data, tmp_path / "r", sequences=("a",))
    ran, killed = calls.read_text().splitlines()
    assert ran.startswith("run freeart21-") and killed.startswith("kill") and "limits" in failure(tmp_path / "r")
    run_method(replace(mine, commands=(("true",),)), data, tmp_path / "p", sequences=("a",), engine="podman")
    assert "podman" in failure(tmp_path / "p")


def test_privileged_inputs_come_from_the_truth_and_are_named(data, tmp_path, answers):
    check = (
        "masks = sorted(pathlib.Path(sys.argv[3]).iterdir())\n"
        "assert masks[0].name == '00000.png' and len(masks) == 16\n"
        "assert 'v ' in open(sys.argv[4]).read()\n"
        "assert all(len(list(pathlib.Path(sys.argv[5], name).iterdir())) == 16 for name in ('rgb', 'depth', 'masks'))\n"
    )
    mine = method(
        SOLVE.format(answers=str(answers)) + check, "{sequence}", "{out}", "{part_masks}", "{mesh_moving}",
        "{rgbd_moving}", inputs=("sequence", "part_masks", "mesh_moving", "rgbd_moving"),
    )  # fmt: skip
    report = run_method(mine, data, tmp_path / "r", sequences=("a",))
    assert report.entries["a"].outcome == "answer", report.entries["a"].reason
    assert read_method(tmp_path / "r").settings["privileged_inputs"] == ["part_masks", "mesh_moving", "rgbd_moving"]


def test_the_shipped_descriptors_are_whole():
    assert len(shipped()) == 10
    for name in shipped():
        found = find_descriptor(name)
        assert found.name == name and found.about and found.code
        assert found.layout == NATIVE or found.layout in layouts()


@pytest.mark.parametrize(
    "change, match",
    [
        ({"commands": [["x", "{truth}"]]}, "'?{truth}'? in"),
        ({"inputs": ["truth"]}, "input 'truth' is unknown"),
        ({"commands": []}, "at least one command"),
        ({"commands": "rm -rf"}, "expected a list"),
        ({"result": "../.."}, "expected a folder in"),
        ({"limits": {"seconds": 0.0, "memory_gb": 1.0}}, "above 0"),
        ({"shell": True}, "'shell'"),
    ],
)
def test_a_bad_descriptor_is_one_line(tmp_path, change, match):
    good = {"schema": SCHEMA, "name": "x", "code": "x", "commands": [["true"]], "inputs": []}
    (tmp_path / "m.json").write_text(json.dumps(good | change))
    assert_refused(match, find_descriptor, str(tmp_path / "m.json"))
    assert_refused("there is no method 'unheard'", find_descriptor, "unheard")


def test_the_command(data, tmp_path, capsys, answers):
    given = {
        "schema": SCHEMA, "name": "mine", "code": "here", "inputs": ["sequence"], "result": "result",
        "commands": [["{python}", "-c", SOLVE.format(answers=str(answers)), "{sequence}", "{out}"]],
        "versions": [["{python}", "-c", "print('solver 3.1')"]],
    }  # fmt: skip
    (tmp_path / "m.json").write_text(json.dumps(given))
    code, out, err = run_command(capsys, "run", tmp_path / "m.json", data, "--out", tmp_path / "r", "--sequences", "a")
    assert code == 0 and not err and "1 answers, 0 declared failures" in out
    run = json.loads((tmp_path / "r" / "run.json").read_text())
    assert run["versions"] == ["solver 3.1"] and run["sequences"]["a"]["outcome"] == "answer"
    assert sys.executable not in json.dumps(run["descriptor"])

    given["versions"] = [["{python}", "-c", "import no_such_package"]]
    (tmp_path / "m.json").write_text(json.dumps(given))
    code, out, err = run_command(capsys, "run", tmp_path / "m.json", data, "--out", tmp_path / "none")
    assert code == 1 and "mine cannot run in this Python" in err and "no_such_package" in err
    assert not (tmp_path / "none").exists()
