"""From an image or recording to its denoised file."""
