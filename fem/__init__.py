"""From a meshed sensor to its response.

In: a design and its mesh. Out: the influence matrix of the array (`ArrayResponse`), the displacement of every upper
electrode per newton on every pad, along each axis. Open `response.py` first, then `elasticity.py` (the equations),
`assembly.py` (the matrices), `patch.py` (loads and electrodes) and `linear_solver.py`.
"""

from fem.array_response import ResponseSettings, array_response, solve_response
from fem.elasticity import ElasticBody, displacement_form, taylor_hood
from fem.linear_solver import SolverError
from fem.patch import PatchError, patch_integrals
from fem.response import ArrayResponse, read_response, write_response

__all__ = [
    "ArrayResponse",
    "ElasticBody",
    "PatchError",
    "ResponseSettings",
    "SolverError",
    "array_response",
    "displacement_form",
    "patch_integrals",
    "read_response",
    "solve_response",
    "taylor_hood",
    "write_response",
]
