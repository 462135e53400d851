"""Writing of text and JSON, whole or not at all."""

import json
from pathlib import Path
from typing import Any

from geometry.storage.files import replacing


def write_text(text: str, path: Path) -> None:
    """Write a text in UTF-8."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(plain: Any, path: Path) -> None:
    """Write dictionaries, lists, strings and numbers."""
    write_text(json.dumps(plain, indent=1, ensure_ascii=False) + "\n", path)
