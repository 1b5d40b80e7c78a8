"""Help and version cost no heavy import; every option has its text; settings come from a file."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tyro
from command_line import run_command
from refusal import assert_refused

from freeart21 import __version__, cli
from freeart21.errors import FreeArtError
from reconstruct.settings import ReconstructSettings, TrackSettings, read_settings

HEAVY = ("sapien", "torch", "scipy", "numba", "cv2", "numpy", "mujoco", "trimesh")


def test_help_and_version_load_nothing_heavy():
    code = (
        "import sys\nfrom freeart21 import cli\n"
        "for words in (['--version'], ['--help'], *([name, '--help'] for name in cli.COMMANDS)):\n"
        "    sys.argv = ['freeart21', *words]\n"
        "    try: cli.main()\n"
        "    except SystemExit as end: assert not end.code, words\n"
        f"print('LOADED', *[m for m in {HEAVY} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"freeart21 {__version__}\n") and done.stdout.endswith("LOADED\n")


def test_the_programs_help_names_every_command(capsys):
    code, text, _ = run_command(capsys, "--help")
    listed = [line.split() for line in text.splitlines() if line.startswith("  ")]
    assert code == 0 and [words[0] for words in listed] == [*cli.COMMANDS] and all(len(words) > 2 for words in listed)


def test_a_command_or_option_that_does_not_exist_is_an_error(capsys):
    code, _, text = run_command(capsys, "recor")
    assert code == 2 and "no command 'recor'" in text and "record" in text
    assert run_command(capsys, "view", "a", "--ouch")[0] == 2


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_option_has_a_text(name: str):
    for action in tyro.extras.get_parser(cli.load(name))._actions:
        assert action.help or "--settings" in action.option_strings[0], action


def test_what_the_help_lists_is_what_there_is():
    from export.exporter import DENSITY
    from export.materials import MATERIALS
    from freeart21.formats.convert import recording_layouts
    from freeart21.formats.measured_series import ROLES
    from freeart21.formats.series_units import EFFORTS, POSITIONS, TIMES
    from generator.motion import PRESETS, STYLES
    from generator.sensors import SENSORS
    from generator.settings import SHADERS

    lists = {
        "convert": [name for name in recording_layouts() if name != "maniskill"],
        "record": [*STYLES, *PRESETS, *SENSORS, *SHADERS],
        "measure": [
            *ROLES,
            *TIMES,
            *(unit for table in (POSITIONS, EFFORTS) for units in table.values() for unit in units),
        ],
        "export": [*MATERIALS, f"plastic ({DENSITY:g}"],
    }
    for name, words in lists.items():
        text = " ".join(str(action.help) for action in tyro.extras.get_parser(cli.load(name))._actions)
        assert [word for word in words if word not in text] == [], name


def test_all_solver_settings_are_behind_a_word_of_their_own(capsys):
    assert "--settings.joint.type-rule" in run_command(capsys, "reconstruct", "--settings.help")[1]
    assert "--settings.tracks.tau-c" not in run_command(capsys, "reconstruct", "--help")[1]


def test_settings_of_a_file_are_those_of_a_result_that_was_made_with_them(tmp_path: Path):
    path = tmp_path / "s.json"
    given = ReconstructSettings(seed=3, renders="video").to_json()
    given["tracks"]["tau_c"] = 0.7
    for data in (given, {"schema": "freeart21/prediction/1", "settings": {"solver": "2", **given}}):
        path.write_text(json.dumps(data))
        assert read_settings(path).to_json() == given
    path.write_text(json.dumps({"seed": 5}))
    assert read_settings(path) == ReconstructSettings(seed=5)


def test_settings_of_a_saved_result_that_no_longer_exist_are_ignored(tmp_path: Path):
    path = tmp_path / "prediction.json"
    older = {"solver": "7", "seed": 5, "seeds": {"gaps": [3]}, "tracks": {"tau_c": 0.7, "tau": 1.0}}
    path.write_text(json.dumps({"schema": "freeart21/prediction/1", "settings": older}))
    assert read_settings(path) == ReconstructSettings(seed=5, tracks=TrackSettings(tau_c=0.7))


@pytest.mark.parametrize(
    "data, message",
    [
        ({"sead": 1}, "settings has 'sead', expected seed, poses_from"),
        ({"tracks": {"tau": 1}}, "settings: 'tracks' has 'tau', expected tracker, "),
        ({"tracks": 3}, "settings: 'tracks' is 3, expected an object"),
        ({"seed": 1.5}, "settings: 'seed' is 1.5, expected a whole number"),
        ({"renders": "mine"}, "settings: 'renders' is 'mine', expected gaussians and video, "),
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
