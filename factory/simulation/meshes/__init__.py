"""Triangle meshes: shapes, files of other programs, the camera and its z-buffer."""
