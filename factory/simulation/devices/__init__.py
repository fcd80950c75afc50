"""Draws a sonar for every image: device, formation, display and rasterisation."""
