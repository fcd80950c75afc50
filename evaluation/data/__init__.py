"""The pairs that are measured: shards of a dataset, or folders of image files."""
