"""Hashes inside files: every damage found before a library parses it, copies of others let through."""

import json

import pytest

from geometry import FileFormatError
from geometry.storage.seal import (
    BLANK,
    KEY,
    LAST_LINE,
    MARK,
    opened_json,
    require_intact,
    sealed,
    sealed_json,
)


@pytest.mark.parametrize("last", [LAST_LINE, b""], ids=["last line", "header"])
def test_every_flipped_bit_is_refused_but_in_the_mark_itself(tmp_path, last):
    """A file whose mark is damaged states no hash, and is refused where one is required; its content is whole."""
    path = tmp_path / "a"
    path.write_bytes(b"".join(sealed(b"x" * 10_000 if last else BLANK + b"x" * 10_000, last)))
    require_intact(path, "mend it", required=True)
    whole = path.read_bytes()
    at = whole.index(MARK)
    for place in [0, 5000, len(whole) - 1, *range(at, at + len(BLANK))]:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(FileFormatError, match="mend it"):
            require_intact(path, "mend it", required=True)
        if not at <= place < at + len(MARK):
            with pytest.raises(FileFormatError, match="damaged, its content does not match the hash it states"):
                require_intact(path, "mend it")


def test_a_file_without_a_hash_passes_unless_one_is_required(tmp_path):
    for content in (b"", b"by hand", MARK + b"12"):
        (tmp_path / "a").write_bytes(content)
        require_intact(tmp_path / "a", "mend it")
        with pytest.raises(FileFormatError, match="states no hash"):
            require_intact(tmp_path / "a", "mend it", required=True)
    require_intact(tmp_path / "none", "its reader says that it is missing", required=True)


def test_json_is_hashed_as_what_it_holds_not_as_it_is_laid_out():
    plain = {"b": [0.1, None, float("nan")], "a": {"ü": 1}}
    text = sealed_json(plain)
    assert str(opened_json(text)) == str(plain)
    again = json.dumps(dict(reversed(json.loads(text).items())), indent=2, ensure_ascii=False)
    assert opened_json(again)["a"] == {"ü": 1}
    with pytest.raises(ValueError, match="drop 'sha256' if you changed them on purpose"):
        opened_json(text.replace("0.1", "0.2"))
    assert opened_json('{"by": "hand"}') == {"by": "hand"}
    assert KEY not in opened_json(text)


@pytest.mark.parametrize("text", ["", "[1]", "17", '{"a": ', "[" * 100_000])
def test_what_is_no_json_object_is_a_value_error(text):
    with pytest.raises(ValueError, match=r"."):
        opened_json(text)
