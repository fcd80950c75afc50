"""What simulated noise and denoisers do, beyond the report on pairs."""
