"""Recordings in time: frames laid over each other, fused where the scene is static."""
