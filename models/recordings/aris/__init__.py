"""ARIS recordings: the file, and where its beams look."""
