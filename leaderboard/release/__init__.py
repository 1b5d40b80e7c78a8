"""A data folder in the forms in which data sets are published: shards with a manifest, BOP (docs/formats.md)."""
