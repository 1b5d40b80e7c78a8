"""The rule that collision shapes match visual meshes, measured by `export.contact`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from export.check.report import Row
from export.check.rules import CONTACT_PERCENT, CONTACT_SHARE
from export.checklist import Shapes
from export.contact import is_closed, measure_contact_fidelity
from export.fidelity import Fidelity
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.certificate import FILE as CERTIFICATE
from freeart21.files.certificate import read_certificate

RULE = "collision.true-to-visual"
_STATED_SHARE = 0.01
"""Fraction of a link's size by which numbers in asset.json may differ: another machine can sample other points. On the
same machine exports reproduce their numbers exactly (two, four links)."""


def judge_contact(seen: Mapping[str, Shapes], touched: Mapping[str, Shapes], folder: Path) -> Row:
    """The row of `RULE`, with the worst link. Links with open visuals are left out, as their inside is undefined.

    Args:
        seen: visual shapes by link.
        touched: collision shapes by link.
        folder: may hold an asset.json that states the same numbers.
    """
    open_links = {name for name, shapes in seen.items() if not all(is_closed(mesh) for _, mesh in shapes)}
    judged = {name: shapes for name, shapes in seen.items() if name not in open_links}
    found = measure_contact_fidelity(judged, touched)
    if not found:
        why = f"visuals of {', '.join(sorted(open_links))} are not closed" if open_links else "no link has both"
        return Row(RULE, "file", "skip", why)
    worst = max(found, key=lambda name: _excess_share(found[name]))
    value = found[worst].size * _excess_share(found[worst])
    wrong = [_describe(name, f) for name, f in found.items() if _excess_share(f) > CONTACT_SHARE]
    wrong += _find_misstated(found, folder)
    return Row(
        RULE, "file", "fail" if wrong else "pass", "; ".join(wrong) or _describe(worst, found[worst]), value, "m"
    )


def _excess_share(f: Fidelity) -> float:
    return max(f.worst_of_95, f.outward_95) / f.size


def _describe(name: str, f: Fidelity) -> str:
    rest = 100 - CONTACT_PERCENT
    return (
        f"link '{name}' of {1000 * f.size:.3g} mm: {rest} % of its visual surface is {1000 * f.worst_of_95:.3g} mm or "
        f"more from its collision shapes, at most {1000 * f.worst:.3g} mm; {rest} % of the shapes' surface is "
        f"{1000 * f.outward_95:.3g} mm or more outside, at most {1000 * f.outward:.3g} mm"
    )


def _find_misstated(found: Mapping[str, Fidelity], folder: Path) -> Iterator[str]:
    """Numbers on contact in asset.json and certificate.json that differ from the files."""
    for file, stated in _read_stated(folder):
        for name, f in found.items():
            for key, value in f.to_json().items():
                number = stated.get(name, {}).get(key)
                if isinstance(number, int | float) and not abs(number - value) <= _STATED_SHARE * f.size:
                    stating = f"{file} states {key} {1000 * number:.3g} mm of '{name}'"
                    yield f"{stating}, its files have {1000 * value:.3g} mm"


def _read_stated(folder: Path) -> Iterator[tuple[str, dict[str, dict[str, Any]]]]:
    """File name, and what it states on contact by link; an invalid file is `certificate.same`'s."""
    with suppress(FreeArtError):
        certificate = read_certificate(folder)
        if certificate is not None:
            yield CERTIFICATE, {name: dict(link.contact) for name, link in certificate.links.items()}
    with suppress(FreeArtError):
        asset = read_asset(folder) if (folder / "asset.json").is_file() else None
        if asset is not None:
            links = {"reference": asset.reference_link, "moving": asset.moving_link}
            yield "asset.json", {link: asset.facts("parts", part, "collision") for part, link in links.items()}
