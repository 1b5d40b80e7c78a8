"""What the documents say holds: links lead somewhere, and the commands, options and modules that are named exist."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from pathlib import Path

import pytest

from freeart21 import cli, processes

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md")))
CURRENT = [path for path in DOCUMENTS if path.name != "CHANGELOG.md"]
"""The changelog names what is gone, too."""


def without_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)


def anchors(document: Path) -> set[str]:
    """Of every heading, as GitHub makes them."""
    headings = re.findall(r"^#+ +(.+)$", without_blocks(document.read_text("utf-8")), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", without_blocks(document.read_text("utf-8"))):
        if not re.match(r"[a-z]+://", target):
            place, _, heading = target.partition("#")
            path = document.parent / place if place else document
            assert path.exists() and (not heading or heading in anchors(path)), target


@pytest.fixture(scope="module")
def options() -> dict[str, set[str]]:
    """Command to its options, as its help names them."""
    found = {}
    for command in cli.COMMANDS:
        shown = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(shown):
            patch.setattr(sys, "argv", ["freeart21", command, "--help"])
            patch.setattr(processes, "listen", lambda: None)
            with contextlib.suppress(SystemExit):
                cli.main()
        found[command] = set(re.findall(r"--[a-z][\w.-]*", shown.getvalue()))
    return found


@pytest.mark.parametrize("document", CURRENT, ids=lambda path: path.name)
def test_commands_and_options_exist(document: Path, options: dict[str, set[str]]) -> None:
    text = without_blocks(document.read_text("utf-8"))
    lines = [re.sub(r"\s#\s.*", "", line).strip() for line in re.findall(r"^    \S.*$", text, re.M)]
    for code in [*re.findall(r"`([^`\n]+)`", text), *lines]:
        for command, rest in re.findall(r"\bfreeart21 ([a-z][a-z-]*)((?: [^|;&]*)?)", code):
            assert command in options, code
            for option in re.findall(r"(?<=\s)--[a-z][\w.-]*", rest):
                assert option.rstrip(".") in options[command] or option.startswith("--settings."), code
    for module in re.findall(r"python -m ([a-z][\w.]+)", text):
        path = ROOT / module.rstrip(".").replace(".", "/")
        assert path.with_suffix(".py").is_file() or path.is_dir() or "." not in module, module


def test_the_commands_were_read(options: dict[str, set[str]]) -> None:
    assert {"--deep", "--truth"} <= options["verify"] and "--from" in options["convert"]
    assert not {"--from", "--layout"} & options["verify"]
