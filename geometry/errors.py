"""The errors a user can cause or meet; each message says what was given, what is allowed, how to mend it."""


class TriPillarError(Exception):
    """Base of all errors that the command line reports as one line with exit code 2."""


class DesignError(TriPillarError, ValueError):
    """A design, a design file or a setting that cannot be built or makes no sense."""


class GeometryError(TriPillarError, ValueError):
    """A solid, a surface or a mesh that failed its check."""


class FileFormatError(TriPillarError, ValueError):
    """A file that is truncated, foreign, or made for something else."""


class NotWrittenError(TriPillarError, OSError):
    """A file that could not be written: the disk is full, or its folder may not be written to."""
