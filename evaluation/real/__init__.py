"""Judges methods on images of a real sonar, for which no ground truth exists."""
