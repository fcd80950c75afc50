"""What every test shares: how hypothesis searches."""

from __future__ import annotations

import os

from hypothesis import settings

# Shared machines are slow now and then, so no deadline.  In CI the same examples every time: a
# change must not fail on an example that it did not cause; at home the search goes on.
settings.register_profile("simnfnd", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("simnfnd")
