"""Figures of merit of images, and their statistics."""
