"""Numbered parts of one job, made by a pool: groups of samples at finite strain, leaves of a data set."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from common.errors import DesignError, TriPillarError
from common.pool import Pool

AHEAD = 2  #: parts given to each worker, so that none waits for what came to be kept


def made_parts(
    pool: Pool, make: Callable[..., Any], numbers: Sequence[int], parts: str, *shared: Any
) -> Iterator[tuple[int, Any]]:
    """Numbers of parts with what `make` (number, *shared) gives, as they come; `parts` names them in messages.

    Raises
    ------
    TriPillarError
        If a part is refused: whoever makes it would meet that again.
    DesignError
        When all others are made, if some failed; or if the scheduler is lost.
    """
    failed: dict[int, Exception] = {}
    for number, made in pool.done(make, numbers, *shared, ahead=AHEAD):
        if isinstance(made, TriPillarError):
            raise made
        if isinstance(made, Exception):
            failed[number] = made
        else:
            yield number, made
    if failed:
        number, error = failed.popitem()
        raise DesignError(
            f"{len(failed) + 1} of {len(numbers)} {parts} failed, such as number {number}: {type(error).__name__}: "
            f"{error}; the others are kept: give the same command again to go on."
        )
