"""The tables of an asset's LOSSES.md: which properties formats and engines lose."""

from __future__ import annotations

from pathlib import Path

from freeart21.files import checked
from freeart21.view.document import Section, escape
from freeart21.view.tables import table_section

FILE = "LOSSES.md"
MAX_BYTES = 1 << 18


def losses_sections(folder: Path) -> list[Section]:
    """A section for every table of LOSSES.md, with the heading above it as title, and one for all other paragraphs.

    Empty without the file. Raises FreeArtError when it is larger than 256 KiB.
    """
    if not (folder / FILE).is_file():
        return []
    title, sections, notes = "", [], []
    for block in checked.read_text(folder / FILE, MAX_BYTES, errors="replace").split("\n\n"):
        lines = block.strip().splitlines()
        if block.startswith("#"):
            title = _plain_text(lines[0].lstrip("# "))
        elif lines and all(line.startswith("|") for line in lines):
            rows = [line.strip("|").split("|") for line in lines if set(line) - set("|-: ")]
            head, *body = [[_plain_text(cell) for cell in row] for row in rows]
            sections.append(table_section(f"What is lost: {title.lower()}", body, head, "full"))
        elif lines:
            notes.append(f"<p>{escape(_plain_text(' '.join(lines)))}</p>")
    if notes:
        sections.append(Section("What is lost: notes", "".join(notes), place="full"))
    return sections


def _plain_text(text: str) -> str:
    """A cell or paragraph of Markdown without its marks."""
    return text.strip().replace("**", "").replace("`", "")
