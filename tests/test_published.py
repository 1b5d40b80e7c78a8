"""The published tables are what the paper prints, line for line, where the paper is at hand; and are never ranked."""

import re
from pathlib import Path

import pytest

from leaderboard.protocols import DEFAULT, PROTOCOLS
from leaderboard.published import PUBLISHED

PAPER = Path(__file__).resolve().parents[2] / "shared" / "paper" / "freeartgs.tex"
COLUMNS = {
    "axis": "axis",
    "position": "position",
    "state": "state",
    "cd-w": "cd_w",
    "cd-m": "cd_m",
    "cd-s": "cd_s",
    "cd": "cd_w",
    "psnr": "psnr",
    "rot. error": "camera_rotation",
    "pos. error": "camera_position",
}
LABELS = {  # by the label of the table: protocol, data set
    "tab:results_free": ("paper-1", "FreeArt-21"),
    "tab:more_ablation": ("paper-1", "FreeArt-21"),
    "tab:combined_results": ("itaco-1", "Video2Articulation-S"),
    "tab:results_video2articulation_cam": ("itaco-1", "Video2Articulation-S"),
    "tab:quantitative results of real": ("paper-1", "six real objects (FreeArtGS)"),
}


def plain(cell: str) -> str:
    """A cell of a LaTeX table without its marks."""
    cell = re.sub(r"~?\\cite\{[^}]*\}", "", cell)
    cell = re.sub(r"\\(multirow|multicolumn)\{[^}]*\}\{[^}]*\}", "", cell)
    cell = re.sub(r"\\begin\{tabular\}.*?\\end\{tabular\}", "", cell, flags=re.S)
    cell = re.sub(r"\\(textbf|boldmath|centering|midrule|toprule|bottomrule|downarrow|uparrow)", "", cell)
    return re.sub(r"[{}$*]", "", cell.replace(r"\%", "%").replace(r"\to", "->")).strip()


def method(name: str) -> str:
    """A printed method's name as ours."""
    name = {"Ours": "FreeArtGS", "ArticulateAnything": "Articulate-Anything", "Average": "FreeArtGS"}.get(name, name)
    name = name.removeprefix("Ours ")
    if name.startswith("w/o"):
        return f"FreeArtGS {name}"
    if "->" in name:
        return f"FreeArtGS, {name.split('->')[1].strip()}"
    return f"FreeArtGS, {name}" if "Noise" in name and "%" in name else name


def numbers(cell: str) -> tuple[float, float | None] | None:
    found = re.findall(r"\d+\.?\d*", cell.replace(r"\pm", " "))
    return None if not found else (float(found[0]), float(found[1]) if len(found) > 1 else None)


def printed() -> dict[tuple[str, str, str, str, str], tuple[float, float | None]]:
    """(protocol, data set, group, method, metric) to mean and standard deviation, of every table of numbers."""
    found = {}
    for table in re.findall(r"\\begin\{table\*?\}.*?\\end\{table\*?\}", PAPER.read_text(), flags=re.S):
        label = re.search(r"\\label\{([^}]*)\}", table)
        if label is None or label[1] not in LABELS:
            continue
        group, columns = "all", []
        for line in table.split(r"\\"):
            group = next((g for g in ("Revolute", "Prismatic") if rf"{g}}}" in line), group)
            if "Geometry" in line:
                group = "all"
            cells = [plain(cell) for cell in re.sub(r"\\begin\{tabular\}\[c\].*?\\end\{tabular\}", "", line).split("&")]
            heads = [re.sub(r"\(.*|\s*$", "", cell.split("\n")[-1]).strip().lower() for cell in cells]
            if any(head in COLUMNS for head in heads):
                columns = [COLUMNS.get(head) for head in heads]
                continue
            if len(cells) != len(columns):
                continue
            name = cells[columns.index(next(c for c in columns if c)) - 1].split("\n")[-1].strip()
            if label[1] == "tab:quantitative results of real" and name != "Average":
                continue
            for column, cell in zip(columns, cells, strict=True):
                if column and (value := numbers(cell)):
                    found[(*LABELS[label[1]], group.lower(), method(name), column)] = value
    return found


def published_values() -> dict[tuple[str, str, str, str, str], tuple[float, float | None]]:
    return {
        (row.protocol, row.dataset, row.group, row.method, id): value
        for row in PUBLISHED
        for id, value in row.values.items()
    }


@pytest.mark.skipif(not PAPER.is_file(), reason="the paper is not at hand")
def test_every_number_is_the_papers():
    paper, ours = printed(), published_values()
    masks = {key: value for key, value in ours.items() if key[-1] == "miou"}
    assert len(paper) > 150
    assert {key: value for key, value in ours.items() if key not in masks} == paper
    rows = re.findall(r"([^\\&\n]*)\S* & \D*(\d+\.\d+)\S* & \D*(\d+\.\d+)", PAPER.read_text().split("tab:iou}")[-1])
    for data, column in (("FreeArt-21", 1), ("Video2Articulation-S", 2)):
        percents = {
            "FreeArtGS" if "Video2" not in row[0] else "Video2Articulation": float(row[column]) for row in rows[:2]
        }
        assert percents == {key[3]: pytest.approx(100 * value[0]) for key, value in masks.items() if key[1] == data}


def test_every_number_is_one_of_its_protocol_and_of_none_that_ranks():
    for row in PUBLISHED:
        rules = PROTOCOLS[row.protocol]
        assert not rules.ranking and row in rules.published and row.values
        for id in row.values:
            assert rules.metric(id).unit(row.group) or row.group == "all", (row, id)
    assert [name for name, rules in PROTOCOLS.items() if rules.ranking] == ["strict-2", DEFAULT]
    assert PROTOCOLS[DEFAULT].published == ()


def test_no_line_stands_twice():
    lines = [(row.protocol, row.dataset, row.group, row.method, id) for row in PUBLISHED for id in row.values]
    assert len(lines) == len(set(lines))
