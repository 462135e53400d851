"""Checks of this machine, for `tripillar doctor`: has it what TriPillar needs, and do known answers come out?

Out: `Check`s. `surroundings.py` looks at packages and devices, `known_answers.py` computes, `foreign.py` finds packages
of others that stand in the way of ours.
"""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Check:
    """One thing that was checked."""

    name: str
    found: str
    advice: str  #: how to mend it; empty if all is well
    state: Literal["ok", "optional", "wrong"]  #: optional: something is missing that only some commands need


def judged(name: str, found: str, advice: str = "", is_optional: bool = False) -> Check:
    """A check that is well without advice."""
    return Check(name, found, advice, "ok" if not advice else "optional" if is_optional else "wrong")
