"""Refine a mesh where the probes need it until they are as accurate as asked."""

from typing import Protocol

import numpy as np
import psutil

from fem.kernel.factor import FactorMemoryError, SolverError
from fem.kernel.newton import UnreachableLoadError
from fem.scene.scene import Scene
from fem.scene.solution import MeshAnswer, Solution, Stopwatch
from geometry.layout import FloatArray

MAX_MESHES = 40  #: no more are tried; some 10 are usual
MAX_SECONDS = 300.0  #: after which no finer mesh is begun, whatever was foreseen
MIN_FREE_SHARE = 0.1  #: of the memory, below which none is begun either; factors that would not fit are refused before


class AdaptiveMesh(Protocol):
    """A mesh that solves its scene and can be refined."""

    def __str__(self) -> str:
        """Number and kind of its elements."""

    def error(self) -> float:
        """Estimated relative error of the probes on the last mesh; infinite where it says too little."""

    def solve(self, watch: Stopwatch) -> MeshAnswer:
        """The scene's answer on the mesh as it is."""

    def limit(self, unknowns: int) -> str | None:
        """The limit that the mesh has reached, in words."""

    def refine(self, indicators: FloatArray, excess: float) -> None:
        """Refine the elements of the largest indicators; `excess` is the error over the tolerance."""


def solve_adaptively(
    scene: Scene, mesh: AdaptiveMesh, watch: Stopwatch, steps: list[str], with_field: bool
) -> Solution:
    """Solve and refine until the estimated error of every probe is within the tolerance.

    Where the tolerance asks for more than the mesh's limit, or more memory than there is, the answer is that of the
    last mesh, with its estimate; the last of the steps says so.
    """
    names = [probe.name for probe in scene.probes]
    answer: MeshAnswer | None = None
    estimate, n_meshes = np.inf, 0
    while True:
        try:
            answer = mesh.solve(watch)
        except (FactorMemoryError, UnreachableLoadError) as error:
            if answer is None or getattr(error, "is_unstable", False):  # a finer mesh is right about what buckles
                raise
            steps.append(f"stopped: {error}")
            break
        if not np.isfinite(answer.indicators).all():
            raise SolverError("error indicators are not numbers: bring moduli and sizes closer.")
        n_meshes += 1
        estimate = mesh.error()
        steps.append(
            f"{mesh}: {answer.unknowns} unknowns" + (f", estimated error {estimate:.1e}" if estimate < np.inf else "")
        )
        if estimate <= scene.tolerance:
            break
        limit = f"{MAX_MESHES} meshes" if n_meshes >= MAX_MESHES else mesh.limit(answer.unknowns)
        if sum(watch.seconds.values()) > MAX_SECONDS:
            limit = f"{MAX_SECONDS:g} s"
        elif psutil.virtual_memory().available < MIN_FREE_SHARE * psutil.virtual_memory().total:
            limit = f"memory, of which less than {MIN_FREE_SHARE:.0%} is free"
        if limit:
            steps.append(f"stopped at the limit of {limit}, short of the tolerance {scene.tolerance:g}")
            break
        mesh.refine(answer.indicators, estimate / scene.tolerance)
        watch.spent("mesh")
    return Solution(
        probes=dict(zip(names, answer.probes, strict=True)),
        energy_mj=answer.energy_mj,
        residual=answer.residual,
        unknowns=answer.unknowns,
        error_estimate=estimate,
        seconds=watch.seconds,
        steps=tuple(steps),
        field=answer.field() if with_field else None,
    )
