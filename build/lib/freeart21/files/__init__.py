"""Readers and writers of the native formats. Files appear whole or not at all; every reader checks what it reads."""
