"""Compiled loops that make procedural frames; imported inside the functions that need them."""
