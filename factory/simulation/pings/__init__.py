"""Pings of a sonar at poses that the caller chooses, one at a time or along a trajectory."""
