"""Every number as a file with its hash, and the command that made the site."""

from __future__ import annotations

import csv
import hashlib
import io
import shlex
from collections.abc import Mapping

from freeart21.view.document import Section, escape
from freeart21.view.tables import row_head, table, value_cell
from leaderboard.rows import Scores
from leaderboard.site.html import Board, hash_text, method_link, page


def scores_csv(scores: Scores) -> bytes:
    """A line per sequence: type, status, reason, source, seconds, every number in its unit, `id_cm` in centimetres."""
    ids = list(dict.fromkeys(id for row in scores.rows for id in row.values))
    lengths = list(dict.fromkeys(id for row in scores.rows for id in row.values_cm))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    words = ("sequence", "joint_type_truth", "status", "reason", "measured_from", "swapped", "seconds")
    writer.writerow([*words, *ids, *(f"{id}_cm" for id in lengths)])
    for row in scores.rows:
        own = [row.sequence, row.joint_type, row.status, row.reason, row.measured_from, int(row.swapped), row.seconds]
        numbers = [*(row.values.get(id) for id in ids), *(row.values_cm.get(id) for id in lengths)]
        writer.writerow([*map(_no_formula, own), *numbers])
    return text.getvalue().encode()


def _no_formula(value: object) -> object:
    """Text that no spreadsheet takes for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value


def downloads_page(board: Board, files: Mapping[str, bytes]) -> bytes:
    """The page; `files` are the tables of the folder scores/ by name."""
    rows = []
    for protocol in board.protocols:
        for entrant in board.entrants:
            cells = []
            for ending, what in (("json", "JSON"), ("csv", "CSV")):
                name = f"{entrant.file}.{protocol}.{ending}"
                link = f'<a href="scores/{name}" download>{what}</a> <small>{len(files[name]) / 1000:.0f} kB</small>'
                cells.append(value_cell(link + hash_text(hashlib.sha256(files[name]).hexdigest()), html=True))
            rows.append([row_head(method_link(entrant, False)), value_cell(protocol), *cells])
    head = ("method", "protocol", "every number, with definitions", "a line per sequence")
    benchmark = board.benchmark
    covered = "videos, and a salted hash of the ground truth" if benchmark.get("hidden") else "videos and ground truth"
    sections = [
        Section(
            "Tables",
            table(rows, head, "downloads", "downloads"),
            place="full",
            note="Below each link: the SHA-256 of the file.",
        ),
        Section(
            "The command that made this site",
            f"<pre tabindex=0>{escape(shlex.join(board.command))}</pre>"
            '<p class="note">The same results, data and version give the same bytes. To check one table: '
            "<code>freeart21 score RESULTS --data DATA --protocol PROTOCOL --out TABLE.json</code>.</p>",
            place="full",
        ),
        Section(
            "The data",
            f'<p class="text">{escape(benchmark["name"])}, version {escape(benchmark["version"])}, '
            f"{escape(benchmark['split'])}. The SHA-256 of its benchmark.json, which has the hash of every file of "
            f"{covered}:</p><p>{hash_text(benchmark['sha256'])}</p>",
            place="full",
        ),
    ]
    return page(board, "Downloads", sections, here="downloads.html")
