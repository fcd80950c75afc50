"""Weights fitted to the static stretches of a user's own recordings."""
