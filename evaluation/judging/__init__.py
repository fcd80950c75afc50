"""Runs and tunes methods on images and scores the results, on worker processes."""
