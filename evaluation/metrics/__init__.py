"""Computes figures of merit of images, and their statistics."""
