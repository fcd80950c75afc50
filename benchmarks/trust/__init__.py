"""Damaged, forged and malicious datasets."""
