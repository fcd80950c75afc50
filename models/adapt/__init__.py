"""Trained weights fitted to somebody's own recordings, without any truth: `simnfnd adapt`."""
