"""Notebooks with their stored outputs as pages of the site."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping
from typing import Any


def markdown(text: str, stem: str) -> tuple[str, dict[str, bytes]]:
    """The page of a notebook (its JSON as `text`), and its pictures by file name.

    stem: what the pictures' names begin with.  Raises ValueError for an output that is neither text
    nor a PNG picture.
    """
    lines: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            lines += [source, ""]
            continue
        lines += ["```python", source, "```", ""]
        for output in cell["outputs"]:
            lines += _output(output, stem, pictures)
    return "\n".join(lines), pictures


def _output(output: Mapping[str, Any], stem: str, pictures: dict[str, bytes]) -> Iterator[str]:
    if output["output_type"] == "stream":
        yield from ("```text", "".join(output["text"]).rstrip(), "```", "")
        return
    data = output.get("data", {})
    if "image/png" in data:
        name = f"{stem}-{len(pictures) + 1}.png"
        pictures[name] = base64.b64decode(data["image/png"])
        yield from (f"![What the cell draws]({name})", "")
    elif "text/plain" in data:
        yield from ("```text", "".join(data["text/plain"]), "```", "")
    else:
        raise ValueError(f"{stem}.ipynb: an output of {sorted(data) or output['output_type']}")
