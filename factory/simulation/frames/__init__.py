"""Defines RGBD frames as every reader delivers them."""
