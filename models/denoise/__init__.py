"""Turns an image or recording into its denoised file."""
