"""Filters by other authors, one file each.

They are written after what is public of a paper and are **no reproductions**: `source` of each
row says so.  What their authors report cannot be checked here.
"""

from __future__ import annotations
