"""From a scene or a design to displacements.

In: a scene (a body, loads, probes) or a sensor's design. Out: the probes' displacements with an estimate of their
error (`solve_scene`), or the influence matrix of the array (`array_response`): what 1 N on a pad does to every
electrode. The rooms, in the order of the data: `scene/` (a scene and its file), `methods/` (open `solving.py` and
`plan.py` first: how a scene is solved), `array/` (open `solving.py` first: the response of an array), `contact/` (open
`indentation.py` first: rigid shapes pressed into it), `boxes/` and `tetrahedra/` (elements), `rubber/` (what fills
them), `system.py` (their equations under loads), `factor.py` (factorisations and checked solves), `field.py`
(displacement and stress anywhere), `pictures/`.
"""

from common.errors import SceneError
from fem.array.response import ArrayResponse, read_response, write_response
from fem.array.solving import ResponseSettings, array_response, solve_response
from fem.kernel.factor import SolverError
from fem.kernel.top import PatchError
from fem.methods.solving import solve_scene
from fem.scene.scene import Scene
from fem.scene.scene_file import read_scene
from fem.scene.solution import Solution

__all__ = [
    "ArrayResponse",
    "PatchError",
    "ResponseSettings",
    "Scene",
    "SceneError",
    "Solution",
    "SolverError",
    "array_response",
    "read_response",
    "read_scene",
    "solve_response",
    "solve_scene",
    "write_response",
]
