"""Names of methods that could be taken for others: reserved ones, and look-alikes of each other."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence

from freeart21.errors import FreeArtError
from freeart21.files.result import Method
from leaderboard.reference import KINDS, is_reference
from leaderboard.submission import escape_unprintable

RESERVED = (*KINDS, "ground truth", "reference")
"""Names of rows that are no methods."""
_LIKE = str.maketrans(
    "\u0430\u0435\u043e\u0440\u0441\u0443\u0445\u0456\u0458\u0455\u0501\u04bb\u0442\u043a\u043c\u043d\u0432"  # Cyrillic
    "\u03b1\u03bf\u03c1\u03c4\u03c5\u03bd\u03ba\u03b9\u03b5"  # Greek
    "0135|!$@",
    "aeopcyxijsdhtkmhbaoptuvkieolesiisa",
)
"""Letters that look like a Latin one, and digits that are read as one (some confusables of Unicode TS 39)."""


def looks_of(name: str) -> str:
    """The name reduced to how it looks: two names with the same one are easily confused."""
    plain = unicodedata.normalize("NFKD", unicodedata.normalize("NFKC", name).casefold()).translate(_LIKE)
    return "".join(c for c in plain if c.isalnum())


def check_name(method: Method, where: object) -> None:
    """FreeArtError where a method has the looks of a reserved name, unless its rows are made from the truth."""
    for reserved in RESERVED:
        if not is_reference(method) and looks_of(method.name) == looks_of(reserved):
            raise FreeArtError(
                f"{where}: the method's name '{escape_unprintable(method.name)}' looks like '{reserved}', which is "
                f"reserved, expected another name in method.json; reserved: {', '.join(RESERVED)}"
            )


def check_names(methods: Sequence[tuple[object, Method]]) -> None:
    """FreeArtError where a name is reserved, or two names that differ look the same."""
    seen: dict[str, tuple[object, str]] = {}
    for where, method in methods:
        check_name(method, where)
        other, name = seen.setdefault(looks_of(method.name) or method.name, (where, method.name))
        if name != method.name:
            raise FreeArtError(
                f"{where}: the method's name '{escape_unprintable(method.name)}' looks like "
                f"'{escape_unprintable(name)}' of {other}, expected names that nobody confuses"
            )
