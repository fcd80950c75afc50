"""The verbs of `simnfnd` that make and look after datasets, a module each."""
