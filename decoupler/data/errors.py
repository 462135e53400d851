"""The errors of this stage, in the tree that the command line reports as one line."""

from geometry.errors import TriPillarError


class TrainingError(TriPillarError, ArithmeticError):
    """A training that ran away."""


class ExportError(TriPillarError, RuntimeError):
    """A model that cannot be exported, or whose exported form gives other forces."""
