"""Serves the page of `simnfnd lab`: sliders for noise and device beside a real image."""
