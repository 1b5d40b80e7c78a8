"""What the documents say holds: the product's readers take the examples, links lead somewhere, options exist."""

from __future__ import annotations

import inspect
import re
import shlex
import typing
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FunctionType

import numpy as np
import pytest
import tyro

from freeart21 import cli
from freeart21.effects import ViscousDamping, effect_from_json
from freeart21.files.asset import read_asset
from freeart21.files.benchmark import read_benchmark, write_benchmark
from freeart21.files.checked import read_json
from freeart21.files.diagnostics import read_confidence, read_diagnostics
from freeart21.files.measured import read_measured
from freeart21.files.result import read_method, read_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.files.verify import verify
from freeart21.reconstruction import Failure, Reconstruction
from generator.motion.styles import STYLES
from generator.sensors import SENSORS

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
_BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.M | re.S)


def named(paths: tuple[Path, ...]) -> list[typing.Any]:
    return [pytest.param(path, id=path.name) for path in paths]


# ---------------------------------------------------------------- the examples of docs/formats.md


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every example of docs/formats.md, written block by block in its order."""
    folder = tmp_path_factory.mktemp("formats")
    namespace: dict[str, typing.Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for language, name, text in _BLOCK.findall((ROOT / "docs" / "formats.md").read_text("utf-8")):
            if name:
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, "utf-8")
            else:
                assert language == "python", f"a block of {language} names no file: {text[:60]}"
                exec(compile(text, "docs/formats.md", "exec"), namespace)
    return folder


def test_the_example_of_a_data_folder_is_read_and_verified(written: Path) -> None:
    benchmark = read_benchmark(written / "data")
    assert benchmark.sequences == ("lid",)
    recording, truth = read_sequence(benchmark.sequence("lid")), read_truth(benchmark.truth("lid"))
    frame = recording.frame(2)
    assert np.isclose(frame.depth[frame.mask], 0.5).all() and (truth.part_mask(2) > 0).sum() == frame.mask.sum()
    (query,) = recording.queries
    assert (query.pose_of_frame, query.state_of_frame) == (0, 2) and truth.query_rgb(0).shape == (6, 8, 3)
    assert np.isclose(read_json(benchmark.truth("lid") / "truth.json")["diagonal_m"], truth.diagonal)
    listed = read_json(written / "data" / "benchmark.json")["sha256"]
    write_benchmark(written / "data", benchmark.name, benchmark.version, benchmark.split)
    assert verify(written / "data").findings == []
    assert listed.items() <= read_json(written / "data" / "benchmark.json")["sha256"].items()


def test_examples_of_single_files_are_read(written: Path) -> None:
    from freeart21.formats.captured import read_track
    from freeart21.joint import Joint
    from generator.session import read_release_effects
    from reconstruct.settings import ReconstructSettings, read_settings

    assert read_settings(written / "settings.json") != ReconstructSettings()
    joint = Joint("joint_1", "revolute", np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0, 1.0)
    assert read_release_effects(written / "effects.json", joint) == (ViscousDamping(0.001),)
    failure = read_result(written / "results" / "failed" / "lid")
    assert isinstance(failure, Failure) and failure.stage == "tracking"
    take = read_track(written / "take.jsonl")
    assert (take.poses, take.joint_type, take.times.tolist()) == ("first", "revolute", [0.0, 0.5, 1.0])
    assert take.states[-1] == 1.2 and np.allclose(take.Ts[-1, :3, 2], [1, 0, 0])


def test_the_example_of_a_result_is_read(written: Path) -> None:
    folder = written / "results" / "mine" / "lid"
    answer = read_result(folder)
    assert isinstance(answer, Reconstruction) and len(answer) == 3
    assert answer.trust.verdict == "doubtful" and len(answer.trust.reasons) == 1
    assert (answer.axis_std, answer.pivot_std) == (0.05, 0.002)
    joint = answer.articulation.joint
    moved = answer.Ts_camera_reference @ joint.transform(answer.states)
    assert np.allclose(moved, answer.Ts_camera_moving), "the joint's frame, or its sense, is not as the page says"
    assert np.isnan(answer.state_std[2]) and not answer.seen[2, 1]
    assert (folder / "renders" / "00000.png").is_file() and (folder / "renders_other" / "00000.png").is_file()
    assert read_method(folder.parent).name == "mine"
    diagnostics = read_diagnostics(folder, 3)
    confidence = read_confidence(folder, 0, (6, 8))
    assert diagnostics is not None and confidence.max() == 240
    look = answer.appearance
    assert look.part_weights.tolist() == [1, 0]
    assert look.scales[0, 0] == pytest.approx(0.01, rel=0.01) and look.light[0] * 0.2821 == pytest.approx(1, abs=1e-3)


def test_the_examples_are_a_right_answer_to_their_own_data(written: Path) -> None:
    """Every frame, unit and sense of the page goes together: no fault is found, and the scorer finds no error."""
    from leaderboard.score import score_results
    from leaderboard.validate import validate_results

    results, data = written / "results" / "mine", written / "data"
    report = validate_results(results, data)
    assert report.faults == () and report.answers == 1
    (row,) = score_results(results, data, "strict-2", limit_s=None).rows
    assert (row.status, row.measured_from, row.swapped, row.notes) == ("ok", "asset", False, ())
    right = {"joint_type": 1.0, "miou": 1.0, "fscore": 1.0, "psnr": 100.0, "ssim": 1.0, "fscore_parts": 1.0}
    assert row.values == pytest.approx(dict.fromkeys(row.values, 0.0) | right, abs=1e-3)


def test_the_example_of_an_asset_is_read(written: Path) -> None:
    asset = read_asset(written / "results" / "mine" / "lid" / "asset")
    assert (asset.joint, asset.reference_link, asset.moving_link) == ("hinge", "reference", "moving")
    assert asset.effects == {"hinge": (ViscousDamping(0.001),)}
    axis = asset.T_canonical_reference[:3, :3] @ [0, 0, -1]
    answer = read_result(written / "results" / "mine" / "lid")
    assert isinstance(answer, Reconstruction) and np.allclose(axis, answer.articulation.joint.axis)


def test_the_example_of_a_measured_set_is_read(written: Path) -> None:
    measured = read_measured(written / "measured")
    step, filmed = measured.runs
    assert measured.actuator is not None and np.isnan(step.q[12]) and step.q_command is not None
    assert filmed.held_out
    answer = read_result(written / "results" / "mine" / "lid")
    assert isinstance(answer, Reconstruction), "the set is of that answer's asset, in its canonical frame"
    assert np.allclose(filmed.poses[0], answer.articulation.joint.transform(0.2))
    asset = read_asset(written / "results" / "mine" / "lid" / "asset")
    assert np.allclose(measured.gravity, asset.T_canonical_reference[:3, :3] @ [0, 0, -9.81])


def test_the_example_of_a_recording_becomes_a_measured_set(written: Path, tmp_path: Path) -> None:
    from freeart21.formats.measured_series import SeriesSettings, columns_from, measure_series

    settings = SeriesSettings(columns_from((str(written / "columns.json"),)))
    asset = written / "results" / "mine" / "lid" / "asset"
    measure_series([written / "swing.csv"], tmp_path / "out", asset, None, settings)
    measured = read_measured(tmp_path / "out" / "measured")
    (run,) = measured.runs
    assert run.q.shape == (21,) and np.isclose(run.q[0], np.radians(11.46)) and measured.rate_hz == pytest.approx(50)
    assert np.allclose(measured.gravity, read_measured(written / "measured").gravity)


def test_the_example_of_a_verdict_is_what_gap_writes(written: Path) -> None:
    from simgap.verdict import Correction, NamedEffect, Proof, Region, RunGap, Verdict

    document = read_json(written / "gap" / "lid" / "verdict.json")
    effects = tuple(
        NamedEffect(
            effect_from_json(
                {
                    "effect": one["name"],
                    "parameters": {k: {"value": v["value"], "unit": v["unit"]} for k, v in one["parameters"].items()},
                },
                "revolute",
                "verdict.json",
            ),
            {k: v["low"] for k, v in one["parameters"].items()},
            {k: v["high"] for k, v in one["parameters"].items()},
        )
        for one in document["effects"]
    )
    verdict = Verdict(
        document["verdict"],
        effects,
        tuple(Region(**where) for where in document["where"]),
        tuple(RunGap(**gap) for gap in document["gap"]),
        tuple(tuple(rival) for rival in document["rivals"]),
        document["next_experiment"],
        document["sentence"],
        tuple(document["added"]),
        corrections=tuple(Correction(**corrected) for corrected in document["corrections"]),
        holding=document["holding"],
        judged_by=document["judged_by"],
        proof=Proof(**document["proof"]),
    )
    verdict.write(written / "again" / "verdict.json", "revolute")
    assert read_json(written / "again" / "verdict.json") == {**document, "files": []}, "nothing lies next to it here"


def test_the_example_of_scores_is_read_and_has_the_fields_that_score_writes(written: Path, tmp_path: Path) -> None:
    from leaderboard.provenance import describe_environment
    from leaderboard.scores_file import read_scores, write_scores

    document, scores = read_json(written / "scores.json"), read_scores(written / "scores.json")
    write_scores(tmp_path / "scores.json", scores)
    again = read_json(tmp_path / "scores.json")
    assert again.keys() == document.keys()
    for key in document.keys() - {"protocol", "summaries"}:
        assert again[key] == document[key]
    assert again["protocol"]["metrics"][0].keys() == document["protocol"]["metrics"][0].keys()
    assert again["summaries"][0]["statistics"]["axis"] == document["summaries"][0]["statistics"]["axis"]
    assert document["made_with"].keys() == describe_environment().keys()
    assert document["made_with"]["machine"].keys() == describe_environment()["machine"].keys()


def test_the_example_of_a_hidden_truth_has_the_fields_that_pack_writes(written: Path, tmp_path: Path) -> None:
    from leaderboard.pack import pack_truth

    pack_truth(written / "data", tmp_path / "hidden", tmp_path / "key")
    assert read_json(written / "hidden" / "hidden.json").keys() == read_json(tmp_path / "hidden" / "hidden.json").keys()


# ---------------------------------------------------------------- links


def test_the_recorders_page_names_every_sensor_and_motion_style() -> None:
    page = (ROOT / "docs" / "recorder.md").read_text("utf-8")
    assert [name for name in (*SENSORS, *STYLES) if f"| `{name}` |" not in page] == []


@pytest.mark.parametrize("document", named(DOCUMENTS))
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", _without_blocks(document.read_text("utf-8"))):
        if re.match(r"[a-z]+://", target):
            continue
        place, _, heading = target.partition("#")
        path = document.parent / place if place else document
        assert path.exists(), f"{document.name} links to {target}, which is not there"
        if heading:
            assert heading in _anchors(path), f"{document.name} links to {target}; headings: {sorted(_anchors(path))}"


def _anchors(document: Path) -> set[str]:
    """Of every heading, as GitHub makes them."""
    headings = re.findall(r"^#+ +(.+)$", _without_blocks(document.read_text("utf-8")), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def _without_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)


# ---------------------------------------------------------------- commands


@pytest.mark.parametrize("document", named(DOCUMENTS))
def test_commands_and_options_exist(document: Path) -> None:
    commands, text = _commands(), document.read_text("utf-8")
    every = set().union(*commands.values())
    for code in _code(text):
        for command, rest in re.findall(r"\bfreeart21 ([a-z][a-z-]*)((?: [^|;&]*)?)", code):
            assert command in commands, f"{document.name}: `{code}`: no command {command}"
            for option in _options(rest):
                assert _known(option, commands[command]), f"{document.name}: `{code}`: {command} has no {option}"
        if code.startswith("--"):
            for option in _options(code):
                assert _known(option, every), f"{document.name}: no command has {option}"


@pytest.mark.parametrize("document", named(DOCUMENTS))
def test_modules_exist(document: Path) -> None:
    for module in re.findall(r"python -m ([\w.]+)", document.read_text("utf-8")):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or path.is_dir(), f"{document.name}: no module {module}"


def test_options_are_those_of_the_command_line() -> None:
    """What is checked above is not vacuous."""
    commands = _commands()
    assert {"--deep", "--truth"} == commands["verify"] - {"--help"}
    assert "--from" in commands["convert"] and "--layout" not in commands["convert"]
    assert _known("--settings.segmentation", commands["reconstruct"])
    assert not _known("--settings.segmentations", commands["reconstruct"])
    assert "--json" in commands["objects"] and "--tier" not in set().union(*commands.values())
    assert len([code for code in _code((ROOT / "README.md").read_text("utf-8")) if "freeart21 " in code]) > 10


def _commands() -> dict[str, set[str]]:
    """Command to options, from the signatures of the functions."""
    return {name: {"--help", *_options_of(typing.cast(FunctionType, f))} for name, f in cli.known_commands().items()}


def _options_of(function: FunctionType) -> set[str]:
    hints = typing.get_type_hints(function, include_extras=True)
    found = set()
    for name in inspect.signature(function).parameters:
        marks = getattr(hints[name], "__metadata__", ())
        if tyro.conf.Positional in marks:
            continue
        names = [one.name for one in marks if getattr(one, "name", None)]
        option = f"--{(names[0] if names else name).replace('_', '-')}"
        found.add(option)
        bare = typing.get_args(hints[name])[0] if marks else hints[name]
        if is_dataclass(bare):
            found |= {f"{option}.help", *_nested(typing.cast(type, bare), option)}
    return found


def _nested(settings: type, prefix: str) -> set[str]:
    found, hints = set(), typing.get_type_hints(settings)
    for field in fields(settings):
        option = f"{prefix}.{field.name.replace('_', '-')}"
        found |= _nested(hints[field.name], option) if is_dataclass(hints[field.name]) else {option}
        if hints[field.name] is bool:
            found.add(f"{prefix}.no-{field.name.replace('_', '-')}")
    return found


def _known(option: str, options: set[str]) -> bool:
    return option in options


def _options(words: str) -> list[str]:
    try:
        parts = shlex.split(words, comments=True)
    except ValueError:
        parts = words.split()
    return [part.split("=")[0].rstrip(".,:;)") for part in parts if part.startswith("--")]


def _code(text: str) -> list[str]:
    """Inline code, and lines of code blocks without their comments."""
    text = _without_blocks(text) + "\n".join(body for _, name, body in _BLOCK.findall(text) if not name)
    lines = [re.sub(r"\s#\s.*", "", line).strip() for line in re.findall(r"^    \S.*$", text, re.M)]
    return [*re.findall(r"`([^`\n]+)`", text), *lines]
