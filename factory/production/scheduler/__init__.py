"""Runs a dataset: plans, locks, runs workers, accounts for failures, resumes."""
