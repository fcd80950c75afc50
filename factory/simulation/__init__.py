"""Turns an RGBD frame into its pairs of noisy and clean images.

Bottom up: `frames` and `meshes`, `scenes` (readers), `render`, `sonar`, `imaging`, `noise`,
`moving` and `devices`, `config` (the whole configuration), `labels`, and `pairs`, which holds the
method.  A room works by its own settings; only `config` and what lies above it see all of them.
"""
