"""How echoes become an image: pointwise (the paper) or coherent (the sonar equation)."""
