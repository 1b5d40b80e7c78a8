"""Who gets in, how much a page may say, and how often the log tells of those who may not."""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

PER_SECOND = 200.0
"""Messages a second of one page: more than ours says (moves at 60, a headset's at 120, pictures seen, a ping)."""
BURST = 400.0
"""Messages at once: a network that held two seconds back."""
MOST_BAD = 1000
"""Bad messages after which a page is shown the door."""
_SAID_EVERY_S = 5.0


def new_token() -> str:
    """A secret of 128 bits, fit for an address."""
    return secrets.token_urlsafe(16)


@dataclass(frozen=True)
class Gate:
    """What a request must have."""

    token: str
    scheme: str
    """'http' or 'https'."""
    hosts: frozenset[str]
    """Names with port by which this server is called; another name that leads here (DNS rebinding) is not ours."""

    @classmethod
    def of(cls, token: str, scheme: str, names: Iterable[str], port: int) -> Gate:
        """The gate of a server that is called by any of `names`, at a port."""
        usual = 443 if scheme == "https" else 80
        bracketed = [f"[{name}]" if ":" in name else name for name in names]
        hosts = {f"{name}:{port}".lower() for name in bracketed}
        return cls(token, scheme, frozenset(hosts | ({n.lower() for n in bracketed} if port == usual else set())))

    def refuses(self, token: str, host: str, origin: str | None, socket: bool) -> str:
        """Why a request does not get in; '' when it does. A socket must come from a page of ours."""
        if host.lower() not in self.hosts:
            return "an address that is not this server's"
        if origin is not None or socket:
            parts = urlsplit(origin or "")
            if (parts.scheme, parts.netloc.lower()) != (self.scheme, host.lower()):
                return "a page of another origin"
        # bytes, as text beyond ASCII cannot be compared in constant time
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()):
            return "no token, or a wrong one"
        return ""


@dataclass
class Allowance:
    """How much one page may still say."""

    bad: int = 0
    _left: float = BURST
    _at: float = field(default_factory=time.monotonic)

    def takes(self, now: float) -> bool:
        """Whether one more message is taken now; those beyond are dropped unread."""
        self._left = min(BURST, self._left + PER_SECOND * (now - self._at))
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class QuietLog:
    """Lines for the log; of each kind one every few seconds, with how many there were."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._kinds: dict[str, tuple[float, int]] = {}

    def dropped(self, why: str, whose: str) -> None:
        """Something of somebody's was dropped; `why` is one of a few texts of ours."""
        now = time.monotonic()
        at, count = self._kinds.get(why, (-_SAID_EVERY_S, 0))
        if now - at >= _SAID_EVERY_S:
            more = f" ({count} more since the last line)" if count else ""
            self._say(f"dropped from {whose}: {why}{more}")
            self._kinds[why] = (now, 0)
        else:
            self._kinds[why] = (at, count + 1)
