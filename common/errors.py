"""The errors a user can cause or meet; each message says what was given, what is allowed, how to mend it."""

from collections.abc import Iterator
from contextlib import contextmanager


class TriPillarError(Exception):
    """Base of all errors that the command line reports as one line with exit code 2."""


class DesignError(TriPillarError, ValueError):
    """A design, a design file or a setting that cannot be built or makes no sense."""


class SceneError(TriPillarError, ValueError):
    """A scene that cannot be built or makes no sense."""


class GeometryError(TriPillarError, ValueError):
    """A solid, a surface or a mesh that failed its check."""


class FileFormatError(TriPillarError, ValueError):
    """A file that is truncated, foreign, or made for something else."""


class NotWrittenError(TriPillarError, OSError):
    """A file that could not be written: the disk is full, or its folder may not be written to."""


class MissingPackageError(TriPillarError, ImportError):
    """A package of an extra of TriPillar is not installed."""


class ArgumentError(TriPillarError, TypeError):
    """An argument of another type than the function takes."""


def require_type(name: str, value: object, kind: type, mend: str) -> None:
    """Refuse an argument of another type than `kind`; `mend` says what to give instead.

    >>> require_type("samples", 3, dict, "give a dict")
    Traceback (most recent call last):
    common.errors.ArgumentError: samples is of type int, expected dict: give a dict.
    """
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} is of type {type(value).__name__}, expected {kind.__name__}: {mend}.")


@contextmanager
def needing(user: str, extra: str) -> Iterator[None]:
    """Around imports: a missing package is refused as a `MissingPackageError` that names the extra to install.

    >>> with needing("MCAP", "mcap"):
    ...     import no_such_package
    Traceback (most recent call last):
    common.errors.MissingPackageError: MCAP needs a package that is not installed (No module named \
'no_such_package'): pip install 'tripillar[mcap]'.
    """
    try:
        yield
    except ImportError as error:
        raise MissingPackageError(
            f"{user} needs a package that is not installed ({error}): pip install 'tripillar[{extra}]'."
        ) from None
