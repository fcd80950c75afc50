"""Turns a frame into its pairs: cached renders, the method, the record of each pair."""
