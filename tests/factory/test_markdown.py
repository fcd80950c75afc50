"""Tables in Markdown."""

from __future__ import annotations

import pytest

from simnfnd.factory import markdown


def test_a_table_is_what_markdown_expects() -> None:
    text = markdown.table(["name", "n", "share"], [["a", 1, "2 %"], ["b", 20, ""]])
    assert text == "| name | n | share |\n|---|---:|---:|\n| a | 1 | 2 % |\n| b | 20 |  |"
    rules = [markdown.table(["x"] * 4, [], align).splitlines()[1] for align in ("l", "llr", "lrc")]
    assert rules == ["|---|---|---|---|", "|---|---|---:|---:|", "|---|---:|:---:|:---:|"]
    assert markdown.table(["x"], [], "lr") == "| x |\n|---|"


def test_nothing_breaks_a_cell() -> None:
    assert markdown.table(["a|b"], [["c\nd | e"]]).splitlines() == [
        r"| a\|b |", "|---|", r"| c d \| e |"
    ]  # fmt: skip
    with pytest.raises(ValueError, match="1 cells under a head of 2"):
        markdown.table(["a", "b"], [["c"]])
