"""Access control: token and origin of requests, and the limits of what pages send."""

from __future__ import annotations

import hmac
import secrets
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
        names = {"127.0.0.1", "localhost", "[::1]", bracketed(self.host).lower()}
        ours = {f"{name}:{self.port}" for name in names} | (names if self.port == 80 else set())
        if not self.secure and host.lower() not in ours:  # DNS rebinding
            return "an address that is not this server's"
        if origin is not None or socket:
            parts = urlsplit(origin or "")
            if (parts.scheme, parts.netloc.lower()) != ("https" if self.secure else "http", host.lower()):
                return "a page of another origin"
        # compare_digest takes no text beyond ASCII
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()):
            return "no token, or a wrong one"
        return ""


def bracketed(host: str) -> str:
    """`host` as it stands in a URL."""
    return f"[{host}]" if ":" in host else host
