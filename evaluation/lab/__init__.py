"""`simnfnd lab`: noise parameters chosen by eye, beside a real image."""
