"""Every number as a file, its hash, and the command that made the site."""

from __future__ import annotations

import csv
import hashlib
import io
import shlex
from collections.abc import Mapping, Sequence

from freeart21.view.document import escape
from leaderboard.rows import Scores
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import method_link, page, section, table


def scores_csv(scores: Scores) -> bytes:
    """A line a sequence: type, status, reason, source, seconds, every number in its unit, `id_cm` in centimetres."""
    ids = list(dict.fromkeys(id for row in scores.rows for id in row.values))
    lengths = list(dict.fromkeys(id for row in scores.rows for id in row.values_cm))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    words = ("sequence", "joint_type_truth", "status", "reason", "measured_from", "swapped", "seconds")
    writer.writerow([*words, *ids, *(f"{id}_cm" for id in lengths)])
    for row in scores.rows:
        said = [row.sequence, row.joint_type, row.status, row.reason, row.measured_from, int(row.swapped), row.seconds]
        writer.writerow(
            [*map(_plain, said), *(row.values.get(id) for id in ids), *(row.values_cm.get(id) for id in lengths)]
        )
    return text.getvalue().encode()


def _plain(value: object) -> object:
    """Text that no spreadsheet takes for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value


def downloads_page(
    site: str,
    entrants: Sequence[Entrant],
    protocols: Sequence[str],
    files: Mapping[str, bytes],
    command: Sequence[str],
    benchmark: Mapping[str, str],
) -> bytes:
    """The page; `files` holds the tables of the folder scores/ by name, `command` the words that made the site."""
    lines = []
    for protocol in protocols:
        for entrant in entrants:
            links = []
            for end, what in (("json", "JSON"), ("csv", "CSV")):
                name = f"{entrant.file}.{protocol}.{end}"
                digest = hashlib.sha256(files[name]).hexdigest()
                links.append(
                    f'<td><a href="scores/{name}" download>{what}</a> <small>{len(files[name]) / 1000:.0f} kB</small>'
                    f'<code class="hash">{digest}</code></td>'
                )
            name = f'<th scope="row">{method_link(entrant, False)}</th>'
            lines.append(f"<tr>{name}<td>{escape(protocol)}</td>{''.join(links)}</tr>")
    heads = ("method", "protocol", "every number, with definitions", "a line a sequence")
    head = "".join(f'<th scope="col">{text}</th>' for text in heads)
    tables = table("downloads", "downloads", head, "".join(lines))
    made = section(
        "The command that made this site",
        f"<pre tabindex=0>{escape(shlex.join(command))}</pre>",
        note="The same results, data and version give the same bytes. To check one table by itself: "
        "<code>freeart21 score RESULTS --data DATA --protocol PROTOCOL --out TABLE.json</code>.",
    )
    data = section(
        "The data",
        f'<p class="text">{escape(benchmark["name"])}, version {escape(benchmark["version"])}, '
        f"{escape(benchmark['split'])}. The SHA-256 of its benchmark.json, which holds the hash of every file "
        f"{'of video, and a salted hash of the truth' if benchmark.get('hidden') else 'of video and truth'}:</p>"
        f'<p><code class="hash">{escape(benchmark["sha256"])}</code></p>',
    )
    tables = section("Tables", tables, note="Below each link: the SHA-256 of the file.")
    return page("Downloads", tables + made + data, site, here="downloads.html")
