"""Bad input is refused as the project promises: by one clear line."""

import pytest

from freeart21.errors import FreeArtError


def assert_refused(match, call, *arguments, **named) -> str:
    """The call raises a FreeArtError of one line that matches the pattern (when there is one). Returns the line."""
    with pytest.raises(FreeArtError, match=match or None) as caught:
        call(*arguments, **named)
    line = str(caught.value)
    assert "\n" not in line
    return line
