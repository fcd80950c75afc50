"""`python -m models` in a checkout: `simnfnd`, where a first word that is no verb means `train`."""

from __future__ import annotations

import sys

from simnfnd.command import main

if __name__ == "__main__":
    sys.exit(main(default="train"))
