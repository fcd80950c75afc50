"""The errors a user is meant to read: one line that names what is wrong and what to do.

Anything else that escapes is a defect of ours and keeps its traceback.
"""

from __future__ import annotations

import errno

OS_REMEDIES = {
    errno.EACCES: "allow this user to read and write it",
    errno.EPERM: "allow this user to read and write it",
    errno.EMFILE: "raise `ulimit -n`, or give fewer scheduler.workers",
    errno.ENOMEM: "raise `ulimit -v`, or give fewer scheduler.workers",
    errno.ENOSPC: "make room on the disk",
    errno.EROFS: "the disk may only be read",
    errno.EIO: "the disk or its network fails",
    errno.ESTALE: "mount its network folder again",
}
"""errno of the machine's own troubles -> what helps; no file is to blame for them."""

MOST_LISTED = 8
"""Things of one kind that a message lists."""


class FactoryError(Exception):
    """Bad input or an environment that cannot do the job; ends the run with exit code 2.

    The message is one line: the file or config key, what is wrong, what to do.
    """


class FrameError(FactoryError):
    """One frame cannot be used.  The run skips it, records the reason and goes on."""


class NotRendered(FactoryError):
    """The render of a frame is not at hand; whoever makes its pairs has it made."""

    def __init__(self, name: str) -> None:
        super().__init__(
            f"{name}: its render is not in the cache; run the same command again, and raise "
            "cache.max_bytes where it vanishes before it is used"
        )
