"""A device of its own for every picture: drawn sonar, formation, display and rasterisation."""
