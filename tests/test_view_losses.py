"""The tables of an asset's LOSSES.md on its page."""

from pathlib import Path

from refusal import assert_refused

from freeart21.view.losses import FILE, MAX_BYTES, losses_sections

TEXT = """# What formats and engines lose of this asset

Joint `hinge` <script>alert(1)</script>.

## Engines

|  | MuJoCo, `object.xml` |
| --- | --- |
| velocity limit | **lost** |
| textures | kept |
"""


def test_each_table_is_a_section_and_the_rest_are_notes(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text(TEXT)
    table, notes = losses_sections(tmp_path)
    assert table.title == "What is lost: engines"
    assert "<th scope=col>MuJoCo, object.xml</th>" in table.html
    assert "<th scope=row>velocity limit</th><td>lost</td>" in table.html
    assert "---" not in table.html
    assert notes.html == "<p>Joint hinge &lt;script&gt;alert(1)&lt;/script&gt;.</p>"


def test_without_the_file_there_is_nothing_and_a_huge_one_is_refused(tmp_path: Path) -> None:
    assert losses_sections(tmp_path) == []
    (tmp_path / FILE).write_text("x" * (MAX_BYTES + 1))
    assert_refused(FILE, losses_sections, tmp_path)
