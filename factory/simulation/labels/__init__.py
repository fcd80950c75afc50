"""What an image shows: boxes, layers of the camera, axes, and the insonified share."""
