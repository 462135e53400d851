"""Trials and how they are judged."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

from geometry.errors import TriPillarError


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a trial found."""

    residual: float | None = None  #: relative, of the linear systems; None where there are none
    error: float
    allowed: float  #: largest error that is right
    against: str  #: what the error is measured against
    note: str = ""  #: what else is to be said
    short_of: float | None = None  #: the tolerance, where the answer says itself that it misses it


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One line of the table before it is tried."""

    name: str
    value: str
    run: Callable[[], Outcome]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of the table."""

    name: str
    value: str
    residual: float | None
    error: float | None
    allowed: float | None
    against: str
    seconds: float
    verdict: str  #: "right", "refused: why", "not tried: why" or "WRONG"; after a colon, what else is to be said


class NotTriedError(TriPillarError):
    """A trial left out because it would not end in any time worth waiting for."""


def tried(trial: Trial) -> Finding:
    """Run a trial and judge it. A refusal is an error that the package itself raises; any other is WRONG."""
    start = perf_counter()
    outcome, verdict = None, ""
    try:
        outcome = trial.run()
        verdict = "right" if outcome.error <= outcome.allowed else "WRONG"  # NaN is WRONG
        if outcome.short_of is not None:
            verdict += f": as estimated, short of its tolerance {outcome.short_of:g}"
        if outcome.note:
            verdict += f": {outcome.note}"
    except NotTriedError as error:
        verdict = f"not tried: {error}"
    except TriPillarError as error:
        verdict = f"refused: {error}"
    except Exception as error:  # whatever it is, a study of crashes reports it and goes on
        verdict = f"WRONG: {type(error).__name__}: {error}"
    return Finding(
        name=trial.name,
        value=trial.value,
        residual=outcome.residual if outcome else None,
        error=outcome.error if outcome else None,
        allowed=outcome.allowed if outcome else None,
        against=outcome.against if outcome else "",
        seconds=perf_counter() - start,
        verdict=verdict,
    )
