"""Effects written into the asset, and replays of runs with its files."""
