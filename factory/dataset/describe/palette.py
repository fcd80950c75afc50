"""Colours of every picture that the factory draws."""

from __future__ import annotations

BACKGROUND, PANEL, LINE = "#0d1117", "#161b22", "#30363d"
TEXT, FAINT = "#e6edf3", "#8b949e"
AMBER, BLUE = "#d98f2b", "#39a0c8"
# Black over amber to near white, as imaging sonars show echoes; shadows in the opposite hue.
ECHO = ("#000000", "#3a1c08", "#8c4a12", "#d98f2b", "#f7d488", "#fffdf2")
SHADOW = ("#000000", BLUE)
