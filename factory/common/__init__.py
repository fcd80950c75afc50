"""Holds what every suite needs: errors, files, isolation, seeds, settings, workers.

Nothing here knows what a sonar is.  It imports no other suite.
"""
