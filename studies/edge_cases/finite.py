"""Trials of finite strain: ν, loads from tiny to the last, slender pillars that buckle, and a mesh for every height."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fem.finite.newton import UnreachableLoadError
from fem.methods.solving import solve_scene
from fem.scene.loads import DeadLoad, FollowerLoad, Load, StiffLoad
from fem.scene.scene import Block, Pillar, Probe, Scene
from fem.scene.solution import largest_error
from geometry.design import Material
from geometry.prism import Triple
from studies.edge_cases.trials import Judged, NotTriedError

RUBBER = Material(model="neo-hookean")
SIDE_MM, TALL_MM = 2.0, 20.0  #: of the slender pillar
CENTER, SIZE = (6.0, 6.0), (6.0, 6.0)
#: kinds of loads by a pressure
KINDS: dict[str, Callable[[float], Load]] = {
    "dead": lambda mpa: DeadLoad(center_mm=CENTER, size_mm=SIZE, traction_mpa=(0.0, 0.0, -mpa)),
    "follower": lambda mpa: FollowerLoad(center_mm=CENTER, size_mm=SIZE, pressure_mpa=mpa),
    "stiff": lambda mpa: StiffLoad(center_mm=CENTER, size_mm=SIZE, force_n=(0.0, 0.0, -36.0 * mpa)),
}
EULER = 2e-2  #: error of Euler's load for a pillar ten times as tall as wide, whose base is held sideways, too
TIGHTER = 1.5  #: times as tight, so that a finer grid is solved
WITHIN = 3.0  #: estimates that an answer may be off by
SMALL_LOAD = 1e-5  #: error of the tangent's answer at 1e-6 MPa: strains squared, and rounding


def pressed_block(load: Load, rubber: Material = RUBBER, tolerance: float = 0.9, height_mm: float = 8.0) -> Scene:
    """A block of 12 × 12 mm under a load on a quarter of its top."""
    probe = Probe(name="pad", kind="mean", center_mm=CENTER, size_mm=SIZE)
    body = Block(size_mm=(12.0, 12.0, height_mm))
    return Scene(body=body, material=rubber, loads=(load,), probes=(probe,), tolerance=tolerance)


def held_to_finer(kind: str, mpa: float, nu: float = 0.49, height_mm: float = 8.0) -> Judged:
    """A loose answer against a tighter one."""
    scene = pressed_block(KINDS[kind](mpa), replace(RUBBER, poisson=nu), height_mm=height_mm)
    loose, _ = solve_scene(scene)
    fine, _ = solve_scene(replace(scene, tolerance=loose.error_estimate / TIGHTER))
    if fine.unknowns <= loose.unknowns:
        raise NotTriedError("a finer grid was not reached, so there is nothing to hold the answer to.")
    error = largest_error(loose.probes, fine.probes)
    allowed = WITHIN * loose.error_estimate
    return Judged(residual=fine.residual, error=error, allowed=allowed, against="a tighter solve")


def tiny_load(kind: str) -> Judged:
    """1e-6 MPa moves as 1e-9 MPa, scaled: the answer is linear there, whatever the kind."""
    scene = pressed_block(KINDS[kind](1e-6))
    one, _ = solve_scene(scene)
    other, _ = solve_scene(replace(scene, loads=(KINDS[kind](1e-9),)))
    error = largest_error({name: 1e3 * u for name, u in other.probes.items()}, one.probes)
    return Judged(residual=one.residual, error=error, allowed=SMALL_LOAD, against="load 1e-9, scaled")


def buckling(share: float, aside: float = 0.0) -> Judged:
    """A pillar under a share of Euler's load, perhaps pushed aside: shortened, bent or refused, never straight beyond.

    Fixed below and free above, P = π² E I / (4 L²); a push aside bends it 1 / (1 − share) times as far as without P.
    """
    E, inertia = RUBBER.young_mpa, SIDE_MM**4 / 12
    mpa = share * np.pi**2 * E * inertia / (4 * TALL_MM**2) / SIDE_MM**2

    def top(traction: Triple) -> np.ndarray:
        size = (SIDE_MM, SIDE_MM)
        load = DeadLoad(center_mm=(0.0, 0.0), size_mm=size, traction_mpa=traction)
        probe = Probe(name="top", kind="mean", center_mm=(0.0, 0.0), size_mm=size)
        body = Pillar(section_mm=size, base_mm=(0.0, 0.0, 0.0), top_mm=(0.0, 0.0, TALL_MM))
        scene = Scene(body=body, material=RUBBER, loads=(load,), probes=(probe,), tolerance=1e-2)
        return np.asarray(solve_scene(scene)[0].probes["top"])

    if aside:
        bent, alone = top((aside, 0.0, -mpa))[0], top((aside, 0.0, 0.0))[0]
        return Judged(
            error=abs(bent / alone * (1 - share) - 1), allowed=EULER / (1 - share), against="Euler's amplification"
        )
    try:
        short = -top((0.0, 0.0, -mpa))[2]
    except UnreachableLoadError:
        if share < 1:
            return Judged(error=np.inf, allowed=0.0, against="Euler's load")
        raise
    if share > 1:
        return Judged(error=np.inf, allowed=0.0, against="Euler's load")
    return Judged(error=abs(short / (mpa / E * TALL_MM) - 1), allowed=2e-2, against="Hooke's shortening")
