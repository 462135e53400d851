"""The array's response: displacement of every upper electrode per newton on every pad, along each axis.

The body is linear, so one factorisation and 3 unit loads a pad hold all there is to know; samples are superposition.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
from skfem import MeshTet

from fem.elasticity import ElasticBody, taylor_hood
from fem.linear_solver import checked_solve, factorized
from fem.patch import patch_means
from geometry.design import SensorDesign
from geometry.design_file import design_from_toml, design_to_toml
from geometry.errors import FileFormatError
from geometry.files import cache_folder, digest
from geometry.layout import AXES, ELECTRODES, FloatArray, electrode_squares, pad_squares
from geometry.mesh import MeshSettings, TetMesh, mesh_recipe, sensor_mesh
from geometry.netcdf import read_netcdf, write_netcdf

METHOD = 1  #: raise when the same design and mesh give another response, so that cached ones are not reused
INFLUENCE_DIMS = ("row", "col", "electrode", "axis", "load_row", "load_col", "load_axis")


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrayResponse:
    """Influence matrix of an array."""

    design: SensorDesign
    influence_mm_per_n: FloatArray  #: (rows, cols, 2, 3, rows, cols, 3), see INFLUENCE_DIMS; axes x, y, z
    residual: float  #: largest relative residual of the solves
    unknowns: int  #: size of the linear system
    mesh_hash: str  #: of the mesh's content
    seconds: dict[str, float]  #: by step
    recipe: str = ""  #: hash of the design and settings it was asked for

    @property
    def content_hash(self) -> str:
        return digest(self.influence_mm_per_n)


def array_response(
    design: SensorDesign,
    settings: MeshSettings,
    progress: Callable[[str], None] = lambda step: None,
) -> tuple[ArrayResponse, Path, bool]:
    """Response of a sensor, from the cache if it is there.

    `progress` is called as each step begins: mesh, assemble, factor, and solve once a row of pads. Returns the
    response, its file, and whether it was there already. Only what bends the body counts: another resistivity finds the
    same file.

    Raises
    ------
    GeometryError, SolverError
        If the mesh or an answer cannot be trusted.
    """
    recipe = response_recipe(design, settings)
    path = cache_folder() / f"response-{recipe}.nc"
    try:
        response = read_response(path)
        if response.recipe == recipe:
            return replace(response, design=design), path, True
    except FileFormatError:
        pass  # missing or damaged: solve again
    progress("mesh")
    start = perf_counter()
    mesh, _, _ = sensor_mesh(design, settings)
    meshed = perf_counter() - start
    response = solve_response(design, mesh, progress)
    response = replace(response, recipe=recipe, seconds={"mesh": meshed} | response.seconds)
    write_response(response, path)
    return response, path, False


def response_recipe(design: SensorDesign, settings: MeshSettings) -> str:
    """Hash of all that a response depends on: the design without its resistivity, the mesh settings, the method."""
    return digest("response", METHOD, replace(design, resistivity_ohm_mm=1.0), mesh_recipe(design, settings))


def solve_response(
    design: SensorDesign, mesh: TetMesh, progress: Callable[[str], None] = lambda step: None
) -> ArrayResponse:
    """Response of a meshed sensor: assemble, factor, solve for a unit force on every pad along every axis."""
    seconds = {}
    start = perf_counter()

    def done(step: str) -> None:
        nonlocal start
        now = perf_counter()
        seconds[step], start = now - start, now

    progress("assemble")
    body = elastic_body(design, mesh)
    pads = patch_means(body.basis, pad_squares(design))
    electrodes = patch_means(body.basis, electrode_squares(design))
    done("assemble")

    progress("factor")
    solve = factorized(body.matrix)
    done("factor")

    columns, residual = [], 0.0
    for row in range(design.array.rows):  # a row of pads at a time bounds the memory
        progress("solve")
        width = 3 * design.array.cols
        # a unit force spread over a pad does work on the pad's mean displacement: its load vector is that mean's
        loads = pads[row * width : (row + 1) * width].T.toarray()
        solution, misfit = checked_solve(body.matrix, solve, body.loads(loads))
        columns.append(electrodes @ body.displacements(solution))
        residual = max(residual, misfit)
    done("solve")

    rows, cols = design.array.rows, design.array.cols
    return ArrayResponse(
        design=design,
        influence_mm_per_n=np.hstack(columns).reshape(rows, cols, len(ELECTRODES), 3, rows, cols, 3),
        residual=residual,
        unknowns=body.matrix.shape[0],
        mesh_hash=mesh.content_hash,
        seconds=seconds,
    )


def elastic_body(design: SensorDesign, mesh: TetMesh) -> ElasticBody:
    """The meshed sensor as a Taylor-Hood body; regions take the matrix's and the pillars' rubber."""
    skfem_mesh = MeshTet(mesh.points_mm.T.copy(), mesh.cells.T.copy())  # scikit-fem keeps points as (3, n)
    return taylor_hood(skfem_mesh, [design.matrix_material, design.pillar_material], mesh.region)


def write_response(response: ArrayResponse, path: Path) -> None:
    """Write a response file, whole or not at all."""
    import xarray as xr

    coordinates = {"electrode": list(ELECTRODES), "axis": list(AXES), "load_axis": list(AXES)}
    attributes = {
        "design": design_to_toml(response.design),
        "recipe": response.recipe,
        "content_hash": response.content_hash,
        "mesh_hash": response.mesh_hash,
        "residual": response.residual,
        "unknowns": response.unknowns,
    } | {f"seconds_{step}": seconds for step, seconds in response.seconds.items()}
    influence = (INFLUENCE_DIMS, response.influence_mm_per_n, {"units": "mm/N"})
    write_netcdf(xr.Dataset({"influence_mm_per_n": influence}, coords=coordinates, attrs=attributes), path)


def read_response(path: Path) -> ArrayResponse:
    """Read a response file that `write_response` wrote; `FileFormatError` if it is truncated or foreign."""
    data = read_netcdf(path, {"influence_mm_per_n": INFLUENCE_DIMS}, made_by="tripillar response")
    try:
        response = ArrayResponse(
            design=design_from_toml(data.attrs["design"], f"{path}, attribute 'design'"),
            influence_mm_per_n=data["influence_mm_per_n"].to_numpy(),
            residual=float(data.attrs["residual"]),
            unknowns=int(data.attrs["unknowns"]),
            mesh_hash=data.attrs["mesh_hash"],
            seconds={
                key.removeprefix("seconds_"): float(value)
                for key, value in data.attrs.items()
                if key.startswith("seconds_")
            },
            recipe=data.attrs["recipe"],
        )
        intact = response.content_hash == data.attrs["content_hash"]
    except KeyError as error:
        raise FileFormatError(f"{path}: attribute {error} is missing: make it again by 'tripillar response'.") from None
    if not intact:
        raise FileFormatError(f"{path}: content does not match its hash: make it again by 'tripillar response'.")
    return response
