"""What is measured: baselines in their forms (default, tuned, with levels) and trained networks."""
