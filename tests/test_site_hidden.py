"""Sites that must not tell the truth: of a set whose truth is hidden, and of tables of scores alone."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_data import Parsed
from score_files import few_samples, submit, table_of, truths, write_data
from synthetic_case import noisy_answer

from freeart21.errors import FreeArtError
from freeart21.files.benchmark import read_benchmark
from freeart21.files.result import Method, write_method, write_result
from freeart21.reconstruction import Failure
from leaderboard.pack import pack_public, pack_truth
from leaderboard.protocols import protocol_named
from leaderboard.score import benchmark_facts, summarise
from leaderboard.scores_file import read_scores, write_scores
from leaderboard.site import build


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """The public half of a set, two methods (one fails twice) and their whole tables. The truth is deleted."""
    folder = tmp_path_factory.mktemp("hidden")
    data = write_data(folder / "data")
    public = folder / "public"
    pack_public(data, public, folder / "key", keep_names=True)
    pack_truth(data, folder / "truth", folder / "key", keep_names=True)
    assert read_benchmark(public, folder / "truth").hidden
    good, weak = (folder / "results" / name for name in ("good", "weak"))
    for k, (name, truth) in enumerate(truths().items()):
        submit(good / name, truth, noisy_answer(truth, k))
    submit(weak / "b", truths()["b"], noisy_answer(truths()["b"], 7))
    write_result(weak / "a", Failure("poses", "it got lost"))
    write_method(good, Method("good"))
    write_method(weak, Method("weak"))
    patch = pytest.MonkeyPatch()
    few_samples(patch)
    facts = benchmark_facts(read_benchmark(public))
    scores = {place: table_of(place, data, "strict-3", facts) for place in (good, weak)}
    patch.undo()
    shutil.rmtree(data)
    shutil.rmtree(folder / "truth")
    return public, scores


@pytest.fixture(scope="module")
def site(world, tmp_path_factory):
    """Built without any truth at hand: whatever is in it cannot come from there but by the tables."""
    public, scores = world
    out = tmp_path_factory.mktemp("out") / "site"
    patch = pytest.MonkeyPatch()
    patch.setattr(build, "cached_scores", lambda folder, *_, **__: scores[folder])
    build.write_site(list(scores), public, out)
    patch.undo()
    return out


@pytest.fixture(scope="module")
def tables(world, tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("tables")
    for place, scores in world[1].items():
        write_scores(folder / f"{place.name}.json", scores)
    return sorted(folder.iterdir())


def numbers_in(site: Path) -> np.ndarray:
    """(n,) every number that stands in any text of the site."""
    found: list[str] = []
    for path in site.rglob("*"):
        if path.suffix in (".html", ".json", ".csv"):
            found += re.findall(r"-?[0-9]+\.[0-9]+", path.read_text("utf-8"))
    return np.array(found, float)


def curves_of(value: Any) -> list[np.ndarray]:
    """Every list of numbers in plain data."""
    if isinstance(value, list) and value and all(isinstance(one, int | float) for one in value):
        return [np.array(value, float)]
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [curve for one in inside for curve in curves_of(one)]


def test_no_number_of_the_truth_is_in_it(site):
    numbers = numbers_in(site)
    assert len(numbers) > 500
    for name, truth in truths().items():
        joint, motion = truth.articulation.joint, float(np.ptp(truth.states))
        secret = [*truth.states[1:], motion, np.rad2deg(motion), 100 * motion, 100 * motion / truth.diagonal]
        secret += [*joint.axis, *joint.pivot]
        for number in secret:
            if abs(number) > 0.01 and abs(round(number, 2) - number) > 1e-3:  # 0.5 and such are everybody's
                near = numbers[np.abs(numbers - number) < 2e-5 * abs(number)]
                assert not len(near), (name, number, near)


def test_no_array_of_the_truth_is_in_it(site):
    for name, truth in truths().items():
        data = Parsed((site / "sequences" / f"{name}.html").read_text()).data
        assert len(data) == 3 and "truth" not in json.dumps([one.get("sources") for one in data])
        for curve in curves_of(data):
            if len(curve) == len(truth):
                for factor in (1, np.rad2deg(1), 100):
                    for sign in (1, -1):
                        shape = curve - curve.mean() - sign * factor * (truth.states - truth.states.mean())
                        assert np.abs(shape).max() > 1e-4 * factor, "a curve is the true one, but for an offset"


def test_words_and_tables_that_are_handed_out_lack_what_is_hidden(site):
    assert "The ground truth is hidden" in (site / "index.html").read_text()
    page = (site / "sequences" / "a.html").read_text()
    assert "The ground truth is hidden" in page and "range</dt>" not in page
    source = truths()["a"].source
    everything = "".join(path.read_text() for path in site.rglob("*.html"))
    assert not any(str(value) in everything for value in source.values() if isinstance(value, str) and len(value) > 3)
    for name in ("good", "weak"):
        scores = read_scores(site / "scores" / f"{name}.strict-3.json")
        assert all(row.values["state"] is None and row.values["state_all"] is None for row in scores.rows)
        assert all("state" not in summary.statistics for summary in scores.summaries)


def test_means_of_joint_states_are_shown_where_they_tell_no_single_one(world):
    """Of two hinges a mean and a deviation tell both ranges; of four they do not."""
    from leaderboard.site.common import columns
    from leaderboard.site.entrant import entrants
    from leaderboard.site.index_page import ranked

    place, weak = list(world[1].items())[1]
    hinges = [row for row in weak.rows if row.joint_type == "revolute"]
    twice = [replace(row, sequence=f"{row.sequence}{k}") for k in range(2) for row in hinges]
    more = replace(weak, rows=tuple(twice), summaries=summarise(twice, protocol_named("strict-3")))
    at = [(metric.id, group) for metric, group in columns(protocol_named("strict-3"))].index(("state", "revolute"))
    for table, there in ((weak, False), (more, True)):
        (line,) = ranked("strict-3", entrants([(place, {"strict-3": table})], "digest"))
        assert (line.means[at] is not None) == there


def test_tables_alone_or_with_folders_make_the_same_numbers(world, tables, site, tmp_path, monkeypatch):
    out = tmp_path / "site"
    build.write_site(tables, None, out)
    assert "data:image" not in "".join(page.read_text() for page in out.rglob("*.html"))
    assert (out / "scores" / "good.strict-3.csv").read_bytes() == (site / "scores/good.strict-3.csv").read_bytes()
    assert "tables of scores only" in (out / "index.html").read_text()
    written = {path.relative_to(out).as_posix() for path in out.rglob("*.html")}
    assert written == {path.relative_to(site).as_posix() for path in site.rglob("*.html")}
    public, scores = world
    monkeypatch.setattr(build, "cached_scores", lambda folder, *_, **__: scores[folder])
    build.write_site([next(iter(scores)), tables[1]], public, out)
    assert "only its table of scores was given" in (out / "sequences" / "b.html").read_text()


def changed(path: Path, out: Path, **changes: Any) -> Path:
    """The table at `path` with other facts of its benchmark (`benchmark_KEY`) or other fields."""
    data = json.loads(path.read_text())
    for key, value in changes.items():
        place, _, name = key.rpartition("__")
        (data[place] if place else data)[name] = value
    out.write_text(json.dumps(data))
    return out


def test_tables_that_do_not_go_together_are_refused_in_one_line(world, tables, tmp_path):
    other = changed(tables[1], tmp_path / "other.json", benchmark__sha256="2" * 64)
    archive = tmp_path / "one.zip"
    archive.write_bytes(b"PK")
    scores = read_scores(tables[1])
    few = replace(scores, rows=scores.rows[:2], summaries=summarise(scores.rows[:2], protocol_named("strict-3")))
    write_scores(short := tmp_path / "short.json", few)
    for results, data, protocols, words in (
        ([tables[0], other], None, (), r"other\.json is scored on made-up"),
        ([tables[0], short], None, (), r"short\.json has rows for 2 of 3"),
        (tables, None, ("paper-1",), r"good\.json is scored by strict-3, expected paper-1"),
        (tables, None, ("strict-3", "paper-1"), r"good\.json: there is no table of good by paper-1"),
        ([tables[0].parent], None, (), r"--data, which it answers"),
        ([archive], None, (), r"one\.zip is an archive"),
    ):
        with pytest.raises(FreeArtError, match=words) as caught:
            build.write_site(results, data, tmp_path / "s", protocols)
        assert "\n" not in str(caught.value) and not (tmp_path / "s").exists()
