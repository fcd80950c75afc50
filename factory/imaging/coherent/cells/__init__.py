"""Cells of the world, in which the coefficients of speckle and texture live, and their loops."""
