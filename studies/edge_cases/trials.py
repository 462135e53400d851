"""Trials and their verdicts."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

from common.errors import TriPillarError


@dataclass(frozen=True, kw_only=True)
class Judged:
    """An answer and the error that it may have."""

    residual: float | None = None  #: relative, of the linear systems; None where there are none
    error: float
    allowed: float  #: largest error that is right
    against: str  #: what the error is measured against
    short_of: float | None = None  #: the tolerance, where the answer says itself that it misses it


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One line of the table before it is tried."""

    name: str
    value: str
    run: Callable[[], Judged]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of the table."""

    name: str
    value: str
    residual: float | None = None
    error: float | None = None
    allowed: float | None = None
    against: str = ""
    seconds: float
    verdict: str  #: "right", "refused: why", "not tried: why" or "WRONG"; after a colon, what else is to be said

    @property
    def is_wrong(self) -> bool:
        return self.verdict.startswith("WRONG")


class NotTriedError(TriPillarError):
    """A trial left out because it would not end in any time worth waiting for."""


def tried(trial: Trial) -> Finding:
    """Run a trial and judge it. A refusal is an error that the package itself raises; any other is WRONG."""
    start, numbers = perf_counter(), {}
    try:
        found = trial.run()
        verdict = "right" if found.error <= found.allowed else "WRONG"  # NaN is WRONG
        if found.short_of is not None:
            verdict += f": as estimated, short of its tolerance {found.short_of:g}"
        numbers = {name: getattr(found, name) for name in ("residual", "error", "allowed", "against")}
    except NotTriedError as error:
        verdict = f"not tried: {error}"
    except TriPillarError as error:
        verdict = f"refused: {error}"
    except Exception as error:  # whatever it is, a study of crashes reports it and goes on
        verdict = f"WRONG: {type(error).__name__}: {error}"
    return Finding(name=trial.name, value=trial.value, seconds=perf_counter() - start, verdict=verdict, **numbers)
