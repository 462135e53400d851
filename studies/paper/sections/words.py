"""Ways to say numbers, the same in all sections."""

from collections.abc import Iterable, Mapping

ALIKE = 2.0  #: ratio up to which two errors are called of one size


def percent(value: float) -> str:
    """A number in %, two decimals as the paper prints, more for what would else be next to nothing."""
    return f"{value:.2f}" if value >= 0.0995 else f"{value:#.2g}"


def both(values: Mapping[str, float]) -> str:
    """Errors of both force components, in %."""
    return f"Fz {percent(values['fz'])} % and Fx {percent(values['fx'])} %"


def than(one: float, other: float) -> str:
    """Which error is which."""
    return "worse" if one > other else "better"


def compared(ours: Mapping[str, float], papers: Mapping[str, float]) -> str:
    """How errors of ours compare with the paper's, force by force.

    >>> compared({"fz": 2.0, "fx": 3.0}, {"fz": 1.6, "fx": 1.0})
    '1.25 times as much in Fz and 3.00 times in Fx'
    """
    times = [f"{ours[name] / papers[name]:.2f} times" for name in papers]
    times[0] += " as much"
    return listed(f"{ratio} in {name.capitalize()}" for ratio, name in zip(times, papers, strict=True))


def of_one_size(ours: Mapping[str, float], papers: Mapping[str, float]) -> bool:
    """Whether no error of ours differs from the paper's by more than a factor of `ALIKE`."""
    return all(1 / ALIKE <= ours[name] / papers[name] <= ALIKE for name in papers)


def strain(share: float) -> str:
    """A strain in %.

    >>> strain(-0.0408)
    '−4.1 %'
    """
    return f"{100 * share:.1f} %".replace("-", "−")


def listed(parts: Iterable[str], last: str = "and") -> str:
    """Words in a row.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    *first, end = parts
    return f"{', '.join(first)} {last} {end}" if first else end


def whole_percent(value: float) -> str:
    """A fraction in whole %.

    >>> whole_percent(0.3)
    '30 %'
    """
    return f"{100 * value:.0f} %"
