"""Griffe extension: what stands in `#:` comments and in `quantity(default, meaning)` documents a dataclass's field."""

import ast
import re
from typing import Any

import griffe

COMMENT = re.compile(r"#: (.+)$")


class FieldComments(griffe.Extension):
    """Gives attributes without a docstring the comment on their own line, or the lines of comment above them."""

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        if attr.docstring is None and attr.lineno is not None and attr.endlineno is not None:
            meaning = _meaning(attr)
            if meaning:
                attr.docstring = griffe.Docstring(meaning, lineno=attr.lineno, parent=attr)


def _meaning(attr: griffe.Attribute) -> str:
    if attr.value is not None and str(attr.value).startswith(("quantity(", "positive(")):
        return str(ast.literal_eval(ast.parse(str(attr.value), mode="eval").body.args[1]))
    lines = attr.lines_collection[attr.filepath]
    for line in lines[attr.lineno - 1 : attr.endlineno]:
        if found := COMMENT.search(line):
            return found[1]
    above = []
    for line in reversed(lines[: attr.lineno - 1]):
        found = re.fullmatch(r"\s*#: (.+)", line)
        if not found:
            break
        above.insert(0, found[1])
    return " ".join(above)
