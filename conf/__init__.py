"""Hydra configuration of the project, shipped as package data."""
