"""The answer as files and a page."""
