"""A device of its own for every image: drawn sonar, formation, display and rasterisation."""
