"""Does denoising help whoever works with the pictures: segmentation and detection, few labels."""
