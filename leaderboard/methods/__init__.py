"""Methods run over a data folder: descriptors (one JSON file a method here), and `run`, which measures and converts."""
