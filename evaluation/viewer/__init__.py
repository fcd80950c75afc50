"""Serves the page of `simnfnd view`, and draws contact sheets."""
