"""From a scene or a design to displacements.

In: a scene (a body, loads, probes) or a sensor's design. Out: the probes' displacements with an estimate of their
error (`solve_scene`), or the influence matrix of the array (`array_response`): what 1 N on a pad does to every
electrode. The rooms, in the order of the data: `meshes/` (scikit-fem's meshes), `kernel/` (rubber on them, whatever is
asked: open `rubber.py` and `system.py` first), `scene/` (a scene, its file and its plan), `conduction/` (currents in
deformed pillars), `finite/` (finite strain), `array/` (open `solving.py` first: the response of an array), `contact/`
(open `driver.py` first: rigid shapes pressed into it), `methods/` (open `solving.py` first: how a scene is solved),
`pictures/`.
"""

from typing import TYPE_CHECKING

from common.lazy import lazily

if TYPE_CHECKING:
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

__getattr__ = lazily(__name__)
