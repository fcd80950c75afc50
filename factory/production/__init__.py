"""Turns words into datasets: the command line, its verbs, the scheduler, and exports."""
