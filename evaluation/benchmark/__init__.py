"""`simnfnd benchmark`: fixed test sets, methods that enter by one door, results and their table."""
