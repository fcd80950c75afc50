"""Images of a real sonar, to which no truth exists: what methods make of them."""
