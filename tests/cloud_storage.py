"""A real S3 server of our own on loopback, for the length of a test."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

BUCKET = "sonar"


@contextmanager
def s3_server(copies: Path) -> Iterator[str]:
    """Start it, point everything of this process and its children to it; the URL of a bucket.

    copies: where local copies go.
    """
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    environment = {
        "AWS_ACCESS_KEY_ID": "us",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "SIMNFND_CLOUD_CACHE": str(copies),
    }
    try:
        with mock.patch.dict(os.environ, environment):
            import fsspec

            fsspec.filesystem("s3").mkdir(BUCKET)
            yield f"s3://{BUCKET}"
    finally:
        server.stop()


def contents(url: str) -> dict[str, bytes]:
    """Name -> content of every object below a URL."""
    import fsspec

    system, root = fsspec.core.url_to_fs(url)
    system.invalidate_cache()
    names = system.find(root)
    actual = system.cat(names, on_error="omit") if names else {}  # a run may be removing some
    return {name[len(root) + 1 :]: content for name, content in actual.items()}


def shards_of(url: str) -> dict[str, bytes]:
    """Those that lie in train/ and test/."""
    return {
        name: content
        for name, content in contents(url).items()
        if name.endswith(".h5") and "/" in name
    }


def manifest_of(url: str) -> dict[str, str]:
    """Shard -> SHA-256 that the manifest at a URL has."""
    document = json.loads(contents(url)["manifest.json"])
    return {shard["path"]: shard["sha256"] for shard in document["shards"]}
