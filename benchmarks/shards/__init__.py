"""Writing and reading shards, here and at a URL."""
