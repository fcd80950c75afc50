"""Networks by other authors, one file each, to be compared with.

They are written after abstracts and are **no reproductions**: sizes, and all that an abstract
leaves open, are ours.  What their authors report cannot be checked here.
"""

from __future__ import annotations
