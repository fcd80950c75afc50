"""`python -m evaluation` in a checkout: `simnfnd`; no verb of its own means `evaluate`."""

from __future__ import annotations

import sys

from simnfnd.command import main

if __name__ == "__main__":
    sys.exit(main(default="evaluate"))
