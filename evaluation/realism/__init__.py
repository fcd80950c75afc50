"""Measures how close simulated images come to real ones, and fits the noise to real ones."""
