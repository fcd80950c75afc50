"""The steps by which `fan_finder` finds a fan, one idea a module.

levels: grey values, and the largest that counts as black.  lit_area: the part of an image that may
hold a fan.  first_guess: an outline to start from.  sector: sectors and outlines, which a fit
varies.  lit_pixels: counts of pixels in a sector.  fit: the likeliest sector.
confidence: the share of an outline that the image shows.  drawn_lines: fans bounded by white lines.
"""
