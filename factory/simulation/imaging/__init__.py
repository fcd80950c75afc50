"""Forms an image of echoes: pointwise (the paper) or coherent (the sonar equation)."""
