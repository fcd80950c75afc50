"""Fits weights to the static stretches of a user's own recordings."""
