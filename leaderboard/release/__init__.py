"""A data folder in the forms in which data sets are published: shards with a manifest, COCO, BOP (docs/formats.md)."""
