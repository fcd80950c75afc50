"""What a frame and a pair cost."""
