"""Holds the verbs that make and maintain datasets, one module each."""
