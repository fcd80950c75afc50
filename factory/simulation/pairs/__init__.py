"""A frame to its pairs: renders from the cache, the method, and the record of each pair."""
