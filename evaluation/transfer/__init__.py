"""Measures how well detectors that learned from simulated images do on real ones."""
