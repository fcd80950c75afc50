"""The whole configuration: its root, what its keys affect, and the identity of a dataset."""
