"""Readers and writers of the native formats. Files are written whole or not at all; readers check all input."""
