"""The rows of /meta: what is recorded of every pair, and what `dataset.columns` adds."""
