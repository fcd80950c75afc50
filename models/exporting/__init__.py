"""Writes weights to pass on: rounded files with a model card, and graphs for onnxruntime."""
