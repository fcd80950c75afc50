"""Objects that move through a recording: drawn once, placed in each frame by pure functions.

settings -> cast (objects and courses) -> bodies at a time -> pixels of the frame -> tracks
"""
