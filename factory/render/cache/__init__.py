"""Renders made once and kept: the cache, its keys, and the views that pairs are made of."""
