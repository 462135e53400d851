"""Pages show the numbers that runs wrote."""

import json

import pytest

from common.errors import FileFormatError
from studies.pages import BLOCK, DOCS, PAGES, TABLES, fill, filled


def test_no_page_is_older_than_its_numbers():
    pages = [(DOCS / name).read_text(encoding="utf-8") for name in PAGES]
    assert {block[1] for page in pages for block in BLOCK.finditer(page)} == set(TABLES)
    for page in pages:
        assert filled(page, DOCS / "numbers") == page, "run python -m studies pages"


def test_new_numbers_of_a_run_come_into_the_page(tmp_path):
    docs, out = tmp_path / "docs", tmp_path / "out" / "robustness"
    (docs / "numbers").mkdir(parents=True)
    out.mkdir(parents=True)
    row = {"truth": "pads", "protocol": "contact", "size": "6 × 6", "pairs": 10, "seconds": 1.0}
    row |= {"error_pct": [1.23456789, 2, 3], "limit_pct": [1, 1, 1], "within_68": [0.7] * 3, "within_95": [0.95] * 3}
    (out / "robustness-pairs.json").write_text(json.dumps([row, row | {"pairs": 3}]), encoding="utf-8")
    (docs / PAGES[0]).write_text("before\n<!-- numbers: truths -->\nold\n<!-- end -->\nafter\n", encoding="utf-8")
    fill(tmp_path / "out", docs)
    shown = (docs / PAGES[0]).read_text(encoding="utf-8").splitlines()
    assert (shown[0], shown[-1]) == ("before", "after")
    (line,) = [line for line in shown if "pads" in line]
    assert line == "| pads, contact, 6 × 6 | 1, 1, 1 | 1.23, 2, 3 | 70, 95 |"
    assert not any("old" in line for line in shown)
    (kept,) = json.loads((docs / "numbers" / "truths.json").read_text(encoding="utf-8"))[:1]
    assert kept["error_pct"][0] == 1.23457
    assert "seconds" not in kept
    other = [row | {"truth": "other", "pairs": pairs} for pairs in (10, 3)]
    (out / "robustness-pairs.json").write_text(json.dumps(other), encoding="utf-8")
    fill(tmp_path / "out", docs)
    both = json.loads((docs / "numbers" / "truths.json").read_text(encoding="utf-8"))
    assert [(row["truth"], row["pairs"]) for row in both] == [("pads", 10), ("pads", 3), ("other", 10), ("other", 3)]
    with pytest.raises(FileFormatError, match="has none of"):
        fill(tmp_path / "nowhere", docs)
