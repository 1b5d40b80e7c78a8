"""The one error that users see: one clear line, then exit code 1."""


class FreeArtError(Exception):
    """Bad input or a missing thing, in one line: the thing, what is wrong, got and expected, what exists."""
