"""The life of a dataset: plan, lock, run on workers, account for failures, resume."""
