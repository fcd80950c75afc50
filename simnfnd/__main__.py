"""`python -m simnfnd` is `simnfnd`."""

from __future__ import annotations

import sys

from simnfnd.command import main

__all__ = ["main"]

if __name__ == "__main__":
    sys.exit(main())
