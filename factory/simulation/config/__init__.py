"""Holds the whole configuration: its root, what keys affect, the identity of a dataset."""
