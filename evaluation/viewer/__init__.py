"""A page in the browser that shows datasets and recordings; served on loopback alone."""
