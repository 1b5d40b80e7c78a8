"""Access control: token and origin of requests, the message rate of pages, and a log of what is dropped."""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

PER_SECOND = 200.0
"""Message rate of a page: more than ours sends (moves at 60, a headset's at 120, acknowledgements, a ping)."""
BURST = 400.0
"""Burst of messages: what a network that stalls for two seconds delivers at once."""
MAX_BAD = 1000
"""Bad messages after which a page is closed."""


@dataclass(frozen=True)
class Gate:
    """The requirements on a request."""

    port: int
    host: str = "127.0.0.1"
    secure: bool = False
    """Whether the server has a certificate: the browser then checks its name against the address."""
    token: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    """A secret of 128 bits, usable in a URL."""

    def refusal(self, token: str, host: str, origin: str | None, socket: bool) -> str:
        """Why a request is refused; '' for an admitted one. A websocket must come from a page of this server."""
        if not self.secure and host.lower() not in self._hosts():  # DNS rebinding
            return "an address that is not this server's"
        if origin is not None or socket:
            parts = urlsplit(origin or "")
            if (parts.scheme, parts.netloc.lower()) != ("https" if self.secure else "http", host.lower()):
                return "a page of another origin"
        # compare_digest takes no text beyond ASCII
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()):
            return "no token, or a wrong one"
        return ""

    def _hosts(self) -> set[str]:
        names = {"127.0.0.1", "localhost", "[::1]", bracketed(self.host).lower()}
        return {f"{name}:{self.port}" for name in names} | (names if self.port == 80 else set())


def bracketed(host: str) -> str:
    """`host` as it stands in a URL."""
    return f"[{host}]" if ":" in host else host


@dataclass
class Allowance:
    """Rate limit of one page (token bucket)."""

    _left: float = BURST
    _at: float = field(default_factory=time.monotonic)

    def allow(self, now: float) -> bool:
        """Whether one more message is accepted now; others are dropped unread."""
        self._left = min(BURST, self._left + PER_SECOND * (now - self._at))
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class LogOfDrops:
    """Reports the first of each kind of what is dropped: a flood of messages is no flood of lines."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._kinds: set[str] = set()

    def report(self, why: str, whose: object) -> None:
        """Report something that was dropped; `why` is one of a few fixed texts."""
        if why not in self._kinds:
            self._kinds.add(why)
            self._say(f"dropped from {whose}: {why} (others of this kind are dropped without a line)")
