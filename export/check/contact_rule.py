"""Whether what can be touched is what can be seen, measured from the files as `export.delivered` measures them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from export.check.report import Row
from export.check.rules import CONTACT_PERCENT, CONTACT_SHARE
from export.delivered import Shapes, closed, contact_fidelity
from export.fidelity import Fidelity
from freeart21.files import checked

RULE = "collision.true-to-visual"
_STATED_SHARE = 0.01
"""Part of a link's size by which numbers in asset.json may differ: another machine may place points elsewhere.
On the one that made them exports have their numbers to the digit (two, four links)."""


def contact_row(seen: Mapping[str, Shapes], touched: Mapping[str, Shapes], folder: Path) -> Row:
    """The row of `RULE`: fails, or passes with the worst link; links whose visuals are not closed are left
    out, as what is inside of them is not known.

    Args:
        seen: visual shapes by link.
        touched: collision shapes by link.
        folder: where an asset.json may state the same numbers.
    """
    open_links = {name for name, shapes in seen.items() if not all(closed(mesh) for _, mesh in shapes)}
    judged = {name: shapes for name, shapes in seen.items() if name not in open_links}
    found = contact_fidelity(judged, touched)
    if not found:
        why = f"visuals of {', '.join(sorted(open_links))} are not closed" if open_links else "no link has both"
        return Row(RULE, "file", "skip", why)
    worst = max(found, key=lambda name: _share(found[name]))
    value = found[worst].size * _share(found[worst])
    wrong = [_text(name, f) for name, f in found.items() if _share(f) > CONTACT_SHARE]
    wrong += _misstated(found, folder / "asset.json")
    return Row(RULE, "file", "fail" if wrong else "pass", "; ".join(wrong) or _text(worst, found[worst]), value, "m")


def _share(f: Fidelity) -> float:
    return max(f.worst_of_95, f.outward_95) / f.size


def _text(name: str, f: Fidelity) -> str:
    rest = 100 - CONTACT_PERCENT
    return (
        f"link '{name}' of {1000 * f.size:.3g} mm: {rest} % of what is seen is {1000 * f.worst_of_95:.3g} mm and more "
        f"from contact, at worst {1000 * f.worst:.3g} mm; {rest} % of contact stands out by {1000 * f.outward_95:.3g} "
        f"mm and more, at worst {1000 * f.outward:.3g} mm"
    )


def _misstated(found: Mapping[str, Fidelity], header: Path) -> Iterator[str]:
    """What asset.json states of contact that its files do not have."""
    if not header.is_file():
        return
    source = checked.read_json(header).get("source")
    parts = source.get("parts") if isinstance(source, dict) else None
    for name, f in found.items():
        part = parts.get(name) if isinstance(parts, dict) else None
        stated = part.get("collision") if isinstance(part, dict) else None
        for key, value in f.said().items():
            said = stated.get(key) if isinstance(stated, dict) else None
            if isinstance(said, int | float) and not abs(said - value) <= _STATED_SHARE * f.size:
                yield f"asset.json states {key} {1000 * said:.3g} mm of '{name}', its files have {1000 * value:.3g} mm"
