"""The suite: reference rows over a data folder, run and scored by one command that may be stopped at any moment."""
