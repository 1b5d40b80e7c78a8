"""The answer as files and an HTML page."""
