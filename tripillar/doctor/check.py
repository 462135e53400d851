"""One thing that was looked at, and how it is."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Check:
    """What was looked at, what was found, and what to do about it."""

    name: str
    state: Literal["ok", "optional", "wrong"]  #: optional: something is missing that only some commands need
    found: str
    advice: str = ""  #: how to mend it; empty if all is well
