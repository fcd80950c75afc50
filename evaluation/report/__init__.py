"""The report: what the figures of all rows say together, and the files that show it."""
