"""Reads and shapes triangle meshes, and draws them through a camera with a z-buffer."""
