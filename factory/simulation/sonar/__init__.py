"""Models the device: its array and range window, polar and fan images, grey values."""
