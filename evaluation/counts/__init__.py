"""Measures how well moving objects are counted, tracked and measured in simulated recordings."""
