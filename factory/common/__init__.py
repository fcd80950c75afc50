"""What every suite needs: errors, files, isolation, seeds, settings, worker processes.

Nothing here knows what a sonar is.  It imports no other suite.
"""
