"""Worker processes of a run, seen from outside."""

from __future__ import annotations

import psutil


def workers_of(pid: int) -> list[psutil.Process]:
    """Living worker processes below `pid`: spawned ones, of pools and of Dask's nannies, and forks.

    A fork has the command line of the template that it was forked from, which is no worker.
    """
    workers = []
    templates = set()
    try:
        children = psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
    for child in children:
        try:
            words = " ".join(child.cmdline())
            if "forkserver" in words and child.ppid() not in templates:
                templates.add(child.pid)
            elif "spawn_main" in words or "forkserver" in words:
                workers.append(child)
        except psutil.NoSuchProcess:  # or a zombie, which is a kind of that
            continue
    return workers
