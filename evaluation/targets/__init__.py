"""Inserts moving targets into static recordings and measures what denoising leaves of them."""
