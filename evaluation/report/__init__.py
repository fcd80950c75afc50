"""Combines the figures of all rows, and writes the files that show them."""
