"""Worker processes of a run, seen from outside."""

from __future__ import annotations

import psutil


def workers_of(pid: int) -> list[psutil.Process]:
    """Living worker processes below `pid` (spawned ones, of pools and of Dask's nannies)."""
    workers = []
    try:
        children = psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
    for child in children:
        try:
            if "spawn_main" in " ".join(child.cmdline()):
                workers.append(child)
        except psutil.NoSuchProcess:  # or a zombie, which is a kind of that
            continue
    return workers
