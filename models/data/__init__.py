"""Provides what networks learn from: pairs, renders with fresh noise, recordings, targets."""
