"""The leaderboard as a static site: whole, self-contained, small, the same every time, safe from what methods say."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urldefrag

import numpy as np
import pytest
from browser import CHROMIUM, browser
from page_data import Parsed
from refusal import assert_refused
from score_files import few_samples, submit, table_of, truths, write_data
from synthetic_case import noisy_answer, static_answer, truth_as_answer, with_names_exchanged

from freeart21.files.places import SITE
from freeart21.files.result import Method, write_method, write_result
from freeart21.reconstruction import Failure
from freeart21.view.tables import NONE
from leaderboard.site import build
from leaderboard.site.entrant import entrants
from leaderboard.site.index_page import ranked
from leaderboard.site.names import file_names
from leaderboard.site.sequence_view import read_answer
from leaderboard.submission import LONGEST_TEXT

HOSTILE = '<script>alert("x")</script> & <img src=https://evil.example/x onerror=alert(1)>'
PROTOCOLS_SHOWN = ("strict-2", "strict-1")
REASON = "</script><script>document.title = 'owned'</script> ' \" --"


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A data folder and three methods: a good one, one of hostile words that fails, and one that lacks pieces."""
    folder = tmp_path_factory.mktemp("site")
    data = write_data(folder / "data")
    good, bad, part = (folder / "results" / name for name in ("good", "bad", "part"))
    for name, truth in truths().items():
        answer = noisy_answer(truth)
        submit(good / name, truth, with_names_exchanged(answer) if name == "b" else answer)
    write_method(good, Method("good", "https://example.org/good 1.0", {"threshold": 0.5}, "one machine"))
    write_method(bad, Method(HOSTILE, REASON, {HOSTILE: REASON}, HOSTILE))
    write_result(bad / "a", Failure("segmentation", REASON))
    submit(bad / "b", truths()["b"], replace(static_answer(truths()["b"])))
    for name, truth in truths().items():
        submit(part / name, truth, renders=False)
    write_method(part, Method("part", lacks=("masks", "meshes", "renders")))
    return data, [good, bad, part]


@pytest.fixture(scope="module")
def score_tables(world):
    """Scores of few samples by two protocols, made once: what they are is other tests' affair."""
    patch = pytest.MonkeyPatch()
    few_samples(patch)
    data, results = world
    facts = {"name": "made-up", "version": "1", "split": "test", "sha256": "0" * 64}
    made = {(folder, name): table_of(folder, data, name, facts) for folder in results for name in PROTOCOLS_SHOWN}
    patch.undo()
    return made


@pytest.fixture(scope="module")
def site(world, score_tables, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "site"
    write(world, score_tables, out)
    return out


def write(world, score_tables, out, **options):
    data, results = world
    patch = pytest.MonkeyPatch()
    patch.setattr(build, "cached_scores", lambda folder, data, protocol, *_, **__: score_tables[folder, protocol])
    try:
        options = {"protocols": PROTOCOLS_SHOWN, "command": ["freeart21", "site", HOSTILE], **options}
        return build.write_site(results, data, out, **options)
    finally:
        patch.undo()


def pages(site: Path) -> list[Path]:
    return sorted(site.rglob("*.html"))


def test_a_page_for_everything_links_within_the_site_and_its_own_script_alone(site):
    """And what methods say of themselves is words, never elements."""
    found = {page: Parsed(page.read_text("utf-8")) for page in pages(site)}
    names = {page.relative_to(site).as_posix() for page in found}
    assert {"index.html", "failures.html", "definitions.html", *(f"sequences/{name}.html" for name in "abc")} <= names
    assert len([name for name in names if name.startswith("methods/")]) == 3 and len(names) == 9
    there = {p.relative_to(site).as_posix() for p in site.rglob("*") if p.is_file()} - {"site.json"}
    assert set(json.loads((site / "site.json").read_text())["files"]) == there
    ids = {page: [value for name, value in parsed.attributes if name == "id"] for page, parsed in found.items()}
    for page, parsed in found.items():
        text = page.read_text("utf-8")
        assert len(set(ids[page])) == len(ids[page]), "two elements have one id"
        for name, address in parsed.attributes:
            assert not name.startswith("on"), (page.name, name)
            if name not in ("href", "src") or address.startswith("data:"):
                continue
            path, mark = urldefrag(unquote(address))
            target = (page.parent / path).resolve() if path else page
            assert not re.match(r"[a-z]+:|//", address) and target.is_relative_to(site.resolve()), (page.name, address)
            assert target.is_file() and (not mark or mark in ids[site / target.relative_to(site.resolve())]), address
        (script,) = [words for is_data, words in parsed.scripts if not is_data]
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert "default-src &#39;none&#39;" in text and f"sha256-{digest}" in text
        assert "<script>alert" not in text and "<script>document" not in text and "<img src=https" not in text
    assert "alert(&#34;x&#34;)" in (site / "index.html").read_text("utf-8")


def test_an_older_site_is_replaced_by_the_same_bytes_and_nothing_else_is(world, score_tables, site, tmp_path):
    out = tmp_path / "site"
    write(world, score_tables, out, title="another")
    assert "another" in (out / "index.html").read_text() and SITE.stands_at(out)
    write(world, score_tables, out)
    for path in sorted(site.rglob("*")):
        assert path.is_dir() or path.read_bytes() == (out / path.relative_to(site)).read_bytes(), path
    (out / "mine.txt").write_text("mine")
    assert_refused(r"mine.txt in it would be lost", write, world, score_tables, out)
    data, results = world
    assert_refused("unknown protocol 'strict-9'", write, world, score_tables, tmp_path / "s", protocols=("strict-9",))
    assert_refused("named twice", build.write_site, [results[0], results[0]], data, tmp_path / "s")
    assert_refused("no results were named", build.write_site, [], data, tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_reasons_stand_where_what_is_missing_would_be_and_numbers_are_traced(site):
    failures = (site / "failures.html").read_text("utf-8")
    assert "Not measured: 2 of 9" in failures and "there is no c among the results" in failures
    sequence = (site / "sequences" / "a.html").read_text("utf-8")
    assert all(words in sequence for words in ("Makes no meshes", "makes no part masks", "segmentation: "))
    assert "without a penalty" in (site / "methods" / "part.html").read_text("utf-8")
    method = (site / "methods" / "good.html").read_text("utf-8")
    facts = "https://example.org/good 1.0", "one machine", "&#34;threshold&#34;: 0.5", "commit", "abc", "0" * 64
    assert all(fact in method for fact in facts)
    assert "freeart21 site &#39;&lt;script&gt;" in (site / "definitions.html").read_text("utf-8")


def test_a_method_without_some_numbers_has_a_place_in_the_tracks_of_the_others(world, score_tables):
    board = entrants([(folder, {"strict-2": score_tables[folder, "strict-2"]}) for folder in world[1]])
    places = ranked("strict-2", board)
    assert [place.entrant.name for place in places] == ["good", HOSTILE, "part"]
    assert [place.text for place in places] == ["1", "1", NONE]  # three sequences tell nobody apart
    assert places[0].standings["whole"].points > places[1].standings["whole"].points
    assert places[2].standings.keys() == {"joint"}
    assert [place.measured for place in places] == [3, 1, 3]


def test_what_was_given_a_part_of_the_truth_has_no_place_and_one_name_is_two(world, score_tables):
    good = score_tables[world[1][0], "strict-2"]
    given = replace(good, method=replace(good.method, settings={"privileged_inputs": ["part_masks"]}))
    board = entrants([(Path("x/one"), {"strict-2": good}), (Path("x/two"), {"strict-2": given})])
    texts = {place.entrant.name: place.text for place in ranked("strict-2", board)}
    assert texts == {"good (one)": "1", "good (two)": "ref."}


def test_names_are_safe_as_names_of_files():
    hostile = ["a", "A", "../../etc/passwd", "con", "a/b", "a b", "", ".", "<script>", "é", "x" * 300, "a", "a?b#c"]
    found = file_names(hostile)
    assert found[0] == "a" and len({name.casefold() for name in found}) == len(hostile)
    assert all(re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name) and len(name) < 90 for name in found)
    assert file_names(["<b>", "plain"])[0] == file_names(["plain", "<b>"])[1]


@pytest.mark.parametrize("kind", ["a", "b"])
def test_an_answer_is_shown_where_scoring_puts_it(world, kind):
    """Truth by another canonical frame and the other part names comes back as the truth."""
    from synthetic_case import in_frame, random_pose

    truth, folder = truths()[kind], world[0].parent / f"moved-{kind}"
    answer = with_names_exchanged(in_frame(truth_as_answer(truth), random_pose(np.random.default_rng(3))))
    submit(folder, truth, answer, renders=False)
    shown = read_answer(folder, truth, [0, 5], True, (), truth.part_mask(0).shape)
    parts = truth.articulation
    assert shown.articulation.reference.vertices == pytest.approx(parts.reference.vertices, abs=1e-6)
    assert shown.articulation.moving.vertices == pytest.approx(parts.moving.vertices, abs=1e-6)
    assert shown.states_of_first == pytest.approx(truth.states, abs=1e-6)
    assert all((shown.masks(i) == truth.part_mask(i)).all() for i in (0, 5))
    at = shown.articulation.joint.transform(shown.sign * 0.4 + shown.offset)
    assert at == pytest.approx(parts.joint.transform(0.4), abs=1e-6)


@pytest.mark.skipif(not CHROMIUM, reason="needs chromium")
def test_every_page_works_in_a_browser(world, score_tables, site, tmp_path):
    """No page has an error or reaches beyond the screen, not even with the longest names."""
    tables = {}
    for (folder, name), table in score_tables.items():
        long = replace(table.method, name="W" * LONGEST_TEXT if folder.name == "good" else table.method.name)
        tables[folder, name] = replace(table, method=long)
    write(world, tables, tmp_path / "long", title="W" * LONGEST_TEXT)
    with browser() as chrome:
        for page in [*pages(site), *(tmp_path / "long").glob("*.html")]:
            for width in (400, 1280):
                chrome.open(page, width, 800)
                assert chrome.run("document.documentElement.scrollWidth") <= width, (page, width)
                assert not chrome.errors, page
        chrome.open(site / "index.html")
        names = "[...document.querySelectorAll('.ranking tbody')[0].rows].map((row) => row.cells[1].textContent.trim())"
        first = chrome.run(names)
        assert first[0] == "good" and first[2] == "part"
        chrome.run("document.querySelector('.ranking thead th:nth-child(2) button').focus()")
        chrome.press("Enter")
        assert chrome.run(names) == sorted(first)
        chrome.open(site / "sequences" / "a.html")
        chips = (
            "[...document.querySelectorAll('.sources .chip')].map((b) => [b.textContent, b.disabled, b.ariaPressed])"
        )
        (truth, *_), (good, *_), *others = chrome.run(chips)
        assert (truth, good) == ("ground truth", "good") and others[0][1] and "segmentation" in others[0][0]
        chrome.run("document.querySelector('.stage canvas').focus()")
        chrome.press("ArrowRight")
        assert "frame 1 " in chrome.run("document.querySelector('.readout').textContent")
        chrome.run("document.querySelector('section[data-kind=curves] .legend button').click()")
        assert chrome.run("document.querySelectorAll('section[data-kind=curves] g.hidden').length") == 1
        assert not chrome.errors
