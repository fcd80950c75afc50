"""Procedural seabed: FLSea-like RGBD frames of invented places, with labels and poses.

A location is a number: it fixes the ground, the objects, the water and the camera's path.  Frames
are drawn by one z-buffer, so depth, labels and pictures agree to the pixel.
"""

from ...labels import CLASSES
from .reader import SeabedReader, SeabedSettings

GENERATOR = 2
"""Version of the frames: changes with their bytes, and is part of the names of cached renders."""

__all__ = ["CLASSES", "GENERATOR", "SeabedReader", "SeabedSettings"]
