"""Every method on every pair, in parallel; what has been measured is kept on disk."""
