"""Scenes on tetrahedra, bisected until the probes are right to the tolerance."""

from fem.methods.adaptive import solve_adaptively
from fem.methods.plan import Plan
from fem.scene.scene import Scene
from fem.scene.solution import Solution, Stopwatch
from fem.tetrahedra.adapted import AdaptedTetrahedra


def solve_on_tetrahedra(scene: Scene, plan: Plan, with_field: bool = False) -> Solution:
    """Solve a scene on tetrahedra, refined until the estimated error of every probe is within the tolerance.

    Parameters
    ----------
    scene : Scene
    plan : Plan
        Of that scene: it names the prisms that need a region of their own.
    with_field : bool
        Also return the displacement of the whole body.
    """
    watch = Stopwatch()
    mesh = AdaptedTetrahedra(scene, plan.regions)
    steps = [f"{mesh} {'from the cache' if mesh.is_kept else 'by the mesher'}"]
    watch.spent("mesh")
    return solve_adaptively(scene, mesh, watch, steps, with_field)
