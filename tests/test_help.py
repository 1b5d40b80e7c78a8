"""`--help` fits a screen, is true to the signature, and costs no heavy import; settings come from a file."""

import inspect
import json
import re
import subprocess
import sys
import typing
from pathlib import Path

import pytest
from refusal import assert_refused

from freeart21 import cli
from freeart21.errors import FreeArtError
from freeart21.help import OPTION_GROUPS, command_help
from reconstruct.settings import ReconstructSettings, TrackSettings, read_settings

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("sapien", "torch", "scipy", "numba", "cv2", "numpy", "mujoco", "trimesh")
SCREEN = 50
"""Lines."""


def run_help(*arguments: str) -> tuple[str, list[str]]:
    """What the command line prints, and the heavy packages that it loaded for it."""
    code = (
        f"import sys; sys.argv = ['freeart21', *{arguments!r}]\n"
        "from freeart21 import cli\n"
        "try: cli.main()\n"
        "except SystemExit: pass\n"
        f"print('LOADED', *[m for m in {HEAVY} if m in sys.modules])"
    )
    environment = {"COLUMNS": "100", "PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    text, _, loaded = done.stdout.rpartition("LOADED")
    return text, loaded.split()


def names() -> list[str]:
    return [line.split()[0] for line in run_help("--help")[0].splitlines() if line.startswith("  ")]


COMMANDS = names()


def test_the_programs_help_names_every_command_in_one_line_each():
    text, loaded = run_help("--help")
    assert {"doctor", "demo", "record", "reconstruct", "export", "score", "measure", "gap", "view"} <= set(COMMANDS)
    assert COMMANDS.index("record") < COMMANDS.index("reconstruct") < COMMANDS.index("export") < COMMANDS.index("score")
    assert len(text.splitlines()) <= SCREEN and max(map(len, text.splitlines())) <= 100
    assert not loaded


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_fits_a_screen_and_tells_every_option(name: str):
    text, loaded = run_help(name, "--help")
    assert len(text.splitlines()) <= SCREEN and max(map(len, text.splitlines())) <= 100
    assert not loaded
    assert text.startswith(f"usage: freeart21 {name} ")
    f = cli.known_commands()[name]
    hints = typing.get_type_hints(f, include_extras=True)
    for parameter in inspect.signature(f).parameters.values():
        flag = "--" + parameter.name.replace("_", "-")
        marks = getattr(hints[parameter.name], "__metadata__", ())
        named = [f"--{one.name}" for one in marks if getattr(one, "name", None)]
        known = named[0] if named else flag
        assert known in text or parameter.name.upper() in text, parameter.name


@pytest.mark.parametrize("name", OPTION_GROUPS)
def test_groups_of_options_name_options_once_each(name: str):
    options = [option for group in OPTION_GROUPS[name].values() for option in group]
    assert len(set(options)) == len(options)
    assert set(options) <= set(inspect.signature(cli.known_commands()[name]).parameters)


def test_an_option_that_has_no_text_would_be_seen():
    """Every option of every command has its line in the docstring."""
    for name in COMMANDS:
        text = command_help(name, cli.known_commands()[name])
        bare = [line for line in text.splitlines() if line.startswith("  --") and len(line.split()) < 3]
        following = text.splitlines()
        for line in bare:
            after = following[following.index(line) + 1]
            assert after.startswith(" " * 20), f"{name}: {line}"


def test_what_the_help_lists_is_what_there_is():
    from export.exporter import DENSITY
    from export.materials import MATERIALS
    from freeart21.formats.convert import recording_layouts
    from freeart21.formats.measured_series import ANGLES, EFFORTS, LENGTHS, ROLES, TIME_UNITS, UNSURE
    from generator.motion import PRESETS, STYLES
    from generator.sensors import SENSORS
    from generator.session import SHADERS

    lists = {
        "convert": [*recording_layouts()],
        "record": [*STYLES, *PRESETS, *SENSORS, *SHADERS],
        "measure": [*ROLES, *ANGLES, *LENGTHS, *EFFORTS, *TIME_UNITS, f"{UNSURE[0]:g} when", f"{UNSURE[1]:g} when"],
        "export": [*MATERIALS, f"plastic ({DENSITY:g}"],
    }
    for name, words in lists.items():
        text = " ".join(command_help(name, cli.known_commands()[name]).split())
        assert [word for word in words if word not in text] == [], name


def test_the_version_is_the_packages():
    import freeart21

    text, loaded = run_help("--version")
    assert text.strip() == f"freeart21 {freeart21.__version__}" and not loaded


def test_all_solver_settings_are_behind_a_word_of_their_own():
    assert "--settings.joint.type-rule" in run_help("reconstruct", "--settings.help")[0]
    assert "--settings.tracks.tau-c" not in run_help("reconstruct", "--help")[0]


def test_settings_of_a_file_are_those_of_a_result_that_was_made_with_them(tmp_path: Path):
    path = tmp_path / "s.json"
    given = ReconstructSettings(seed=3, segmentation="paper").to_json()
    given["tracks"]["tau_c"] = 0.7
    for data in (given, {"schema": "freeart21/prediction/1", "settings": {"solver": "2", **given}}):
        path.write_text(json.dumps(data))
        assert read_settings(path).to_json() == given
    path.write_text(json.dumps({"seed": 5}))
    assert read_settings(path) == ReconstructSettings(seed=5)


def test_settings_of_a_saved_result_that_no_longer_exist_are_ignored_with_a_note(tmp_path: Path, capsys):
    path = tmp_path / "prediction.json"
    older = {"solver": "7", "seed": 5, "seeds": {"gaps": [3]}, "tracks": {"tau_c": 0.7, "tau": 1.0}}
    path.write_text(json.dumps({"schema": "freeart21/prediction/1", "settings": older}))
    assert read_settings(path) == ReconstructSettings(seed=5, tracks=TrackSettings(tau_c=0.7))
    assert "2 settings that this version does not have are ignored, such as seeds" in capsys.readouterr().err


@pytest.mark.parametrize(
    "data, message",
    [
        ({"sead": 1}, "there is no setting 'sead'; settings: seed, segmentation"),
        ({"tracks": {"tau": 1}}, "there is no setting 'tracks.tau'; tracks.: tracker, max_round_trip"),
        ({"tracks": 3}, "setting 'tracks' is 3, expected an object"),
        ({"seed": 1.5}, "setting 'seed' is 1.5, expected a whole number"),
        ({"tracks": {"tau_c": True}}, "setting 'tracks.tau_c' is True, expected a number"),
        ({"segmentation": "mine"}, "setting 'segmentation' is 'mine', expected ours or paper"),
    ],
)
def test_a_setting_that_does_not_exist_costs_one_line(tmp_path: Path, data: dict, message: str):
    path = tmp_path / "s.json"
    path.write_text(json.dumps(data))
    assert_refused(re.escape(message), read_settings, path)


def test_options_of_the_command_line_come_after_those_of_the_file(tmp_path: Path, monkeypatch):
    path = tmp_path / "s.json"
    path.write_text(json.dumps({"seed": 5, "tracks": {"tau_c": 0.7, "stride": 4}}))
    got = []

    def solved(sequence, out, settings, keep_work):
        got.append(settings)
        raise FreeArtError("seen")

    monkeypatch.setattr("reconstruct.pipeline.reconstruct_folder", solved)
    for more in ((), ("--settings.tracks.tau-c", "0.5")):
        command = ["freeart21", "reconstruct", "seq", "--out", str(tmp_path / "o"), "--settings", str(path), *more]
        monkeypatch.setattr(sys, "argv", command)
        with pytest.raises(SystemExit, match="freeart21: "):
            cli.main()
    assert [s.seed for s in got] == [5, 5] and [s.tracks.stride for s in got] == [4, 4]
    assert [s.tracks.tau_c for s in got] == [0.7, 0.5]
    path.write_text("[")
    with pytest.raises(SystemExit, match=r"freeart21: .*s\.json is not JSON"):
        cli.main()
