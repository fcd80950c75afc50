"""How good are the pictures: metrics, measurements over whole datasets, reports."""
