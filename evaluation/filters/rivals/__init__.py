"""Filters by other authors, one file each.

Most are written after what is public of a paper, often its abstract alone, and are **no
reproductions**: `source` of each row says so.  What their authors report cannot be checked here.
"""

from __future__ import annotations
