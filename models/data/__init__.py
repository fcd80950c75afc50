"""What networks learn from: pairs, renders with fresh noise, recordings, moving targets."""
