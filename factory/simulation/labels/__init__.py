"""Computes the labels of an image: boxes, layers of the camera, axes, insonified share."""
