"""Methods times images times metrics: what is judged, tuned and run on worker processes."""
