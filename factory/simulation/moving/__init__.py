"""Moves objects through a recording: draws them once, places them in each frame.

settings -> cast (objects and courses) -> bodies at a time -> pixels of the frame -> tracks
"""
