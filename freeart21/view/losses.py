"""What formats and engines lose of an asset, as its page shows it: the tables of its LOSSES.md."""

from __future__ import annotations

from pathlib import Path

from freeart21.files import checked
from freeart21.view.document import Section, escape
from freeart21.view.tables import table_section

FILE = "LOSSES.md"
MAX_BYTES = 1 << 18


def losses_sections(folder: Path) -> list[Section]:
    """A section for every table of LOSSES.md, titled by the heading above it, and one of what else it says.

    None when there is no such file. Raises FreeArtError when it is larger than 256 KiB.
    """
    if not (folder / FILE).is_file():
        return []
    text = checked.read_text(folder / FILE, MAX_BYTES, errors="replace")
    title, sections, notes = "", [], []
    for block in text.split("\n\n"):
        lines = block.strip().splitlines()
        if block.startswith("#"):
            title = _plain(lines[0].lstrip("# "))
        elif lines and all(line.startswith("|") for line in lines):
            head, *rows = [
                [_plain(cell) for cell in line.strip("|").split("|")] for line in lines if set(line) - set("|-: ")
            ]
            sections.append(table_section(f"What is lost: {title.lower()}", rows, head, "full"))
        elif lines:
            notes.append(_plain(" ".join(lines)))
    if notes:
        paragraphs = "".join(f"<p>{escape(note)}</p>" for note in notes)
        sections.append(Section("What is lost: notes", paragraphs, place="full"))
    return sections


def _plain(text: str) -> str:
    """A cell or paragraph of Markdown without its marks."""
    return text.strip().replace("**", "").replace("`", "")
