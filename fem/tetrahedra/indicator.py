"""Error indicators: how far an answer misses equilibrium in each element.

The residual of an answer u is what the stress leaves unbalanced: div σ inside the elements, jumps of the traction σ·n
across their faces, traction missing on the surface, and div u − p/λ in the mixed form. The error of a probe is at most
a constant times the sum over the elements of the product of two such residuals: of the answer, and of the answer to a
unit load on the probe (Becker and Rannacher, Acta Numerica 10, 2001).
"""

import numpy as np
from skfem import MeshTet

from fem.scene.solution import SMALLEST_SHARE
from fem.tetrahedra.mixed import IntArray, TaylorHood
from geometry.layout import FloatArray

MAX_DUALS = 12  #: unit loads on probes solved for each mesh; with more probes, random sums of them
SUBDIVISION = 4  #: a loaded face is sampled in the middle of each of the 4² parts of it


def residuals(
    body: TaylorHood,
    u: FloatArray,
    pressure: FloatArray,
    rectangles: FloatArray,
    tractions_mpa: FloatArray,
    plates: FloatArray,
) -> FloatArray:
    """Squared residual of an answer in each element, in units of energy.

    Parameters
    ----------
    body : TaylorHood
    u : array, shape (n_displacement,)
        Nodal displacements [mm].
    pressure : array, shape (n_pressure,)
        Corner pressures of the mixed form [MPa].
    rectangles : array, shape (n, 4)
        Of the top face, under uniform loads, which add up where they overlap.
    tractions_mpa : array, shape (n, 3)
        Of these loads.
    plates : array, shape (k, 4)
        Rectangles of the top face that follow stiff plates, whose tractions nobody knows.

    Returns
    -------
    array, shape (m,) [N mm]
    """
    mesh = body.basis.mesh
    points, cells = mesh.p.T, mesh.t.T
    elements = body.elements
    gradient = elements.corner_gradients(u.reshape(-1, 3))
    divergence = np.trace(gradient, axis1=2, axis2=3)
    p, lame_mpa, mu_mpa = pressure[body.corners.T], body.law.lame_mpa[:, 0], body.law.mu_mpa[:, 0]
    stress = mu_mpa[:, None, None, None] * (gradient + gradient.swapaxes(2, 3))
    for i in range(3):
        stress[..., i, i] += p

    corners = points[cells]
    volumes = elements.volumes_mm3
    unbalanced = np.einsum("evij,evj->ei", stress[:, 1:] - stress[:, :1], elements.inverse_jacobian)
    squared: FloatArray = np.cbrt(6 * volumes) ** 2 * volumes * (unbalanced**2).sum(axis=1) / mu_mpa
    squared += mu_mpa * _integral_of_square((divergence - p / lame_mpa[:, None])[..., None], volumes)

    facets, sides = mesh.facets.T, mesh.f2t
    triangles = points[facets]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normal, axis=1) / 2
    normal /= 2 * areas[:, None]

    def tractions(side: int, chosen: IntArray) -> FloatArray:
        """σ·n at the corners of facets, from the elements on one side, shape (k, 3, 3)."""
        element = sides[side, chosen]
        corner = (cells[element][:, None, :] == facets[chosen][:, :, None]).argmax(axis=2)
        return np.einsum("fvij,fj->fvi", stress[element[:, None], corner], normal[chosen])

    inner = np.flatnonzero(sides[1] >= 0)
    jump = _integral_of_square(tractions(0, inner) - tractions(1, inner), areas[inner]) * np.sqrt(areas[inner])
    for side in (0, 1):
        element = sides[side, inner]
        squared += np.bincount(element, 0.5 * jump / mu_mpa[element], len(cells))

    outer = np.flatnonzero((sides[1] < 0) & (triangles[..., 2] != 0.0).any(axis=1))
    element = sides[0, outer]
    outward = triangles[outer].mean(axis=1) - corners[element].mean(axis=1)
    missing = tractions(0, outer) * np.sign((outward * normal[outer]).sum(axis=1))[:, None, None]
    misfit = _integral_of_square(missing, areas[outer])
    top = (triangles[outer][..., 2] == points[:, 2].max()).all(axis=1)
    if len(rectangles):
        weights = _middles(SUBDIVISION)
        places = np.einsum("qv,fvi->fqi", weights, triangles[outer][top])
        found = np.einsum("qv,fvi->fqi", weights, missing[top])
        misfit[top] = ((found - _tractions_at(places, rectangles, tractions_mpa)) ** 2).sum(axis=2).mean(
            axis=1
        ) * areas[outer][top]
    middle = triangles[outer].mean(axis=1)
    for x0, y0, x1, y1 in plates:
        misfit[top & ((middle[:, :2] > (x0, y0)) & (middle[:, :2] < (x1, y1))).all(axis=1)] = 0.0
    return squared + np.bincount(element, np.sqrt(areas[outer]) * misfit / mu_mpa[element], len(cells))


def probe_indicators(of_answer: FloatArray, of_duals: list[FloatArray], scales: FloatArray) -> FloatArray:
    """Share of each element in the relative errors of the probes, up to a constant, shape (m,).

    `of_answer` and `of_duals` are `residuals`; `scales` are the sizes of the probes' displacements.
    """
    return sum(
        (np.sqrt(of_answer * dual) / scale for dual, scale in zip(of_duals, scales, strict=True)),
        start=np.zeros_like(of_answer),
    )


def dual_weights(probes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit loads on probes by whose answers their errors are traced to elements.

    One for each probe and axis; of more than `MAX_DUALS`, as many sums of all with random signs, which together mark
    the same elements.

    Parameters
    ----------
    probes : array, shape (n_probes, 3)
        Displacements of the probes [mm].

    Returns
    -------
    array, shape (k, n_probes, 3): the weight of each probe's components in each load
    array, shape (k,): the displacement that each load's error is relative to [mm]
    """
    size = np.linalg.norm(probes, axis=1)
    scale = np.maximum(size, SMALLEST_SHARE * size.max())
    scale[scale == 0.0] = 1.0
    n = len(probes)
    if 3 * n > MAX_DUALS:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (MAX_DUALS, n, 3))
        return signs / scale[:, None], np.ones(MAX_DUALS)
    return np.eye(3 * n).reshape(3 * n, n, 3), np.repeat(scale, 3)


def largest_contributors(indicators: FloatArray, share: float) -> IntArray:
    """The fewest elements that hold a share of the sum of all indicators (Dörfler's rule)."""
    order = np.argsort(-indicators)
    running = np.cumsum(indicators[order])
    return order[: int(np.searchsorted(running, share * running[-1])) + 1]


def _tractions_at(points: FloatArray, rectangles: FloatArray, tractions_mpa: FloatArray) -> FloatArray:
    """The sum of uniform loads on rectangles at points (..., 3) of the top face, of the same shape [MPa]."""
    total = np.zeros(points.shape)
    x, y = points[..., 0], points[..., 1]
    for (x0, y0, x1, y1), value in zip(rectangles, tractions_mpa, strict=True):
        total[(x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)] += value
    return total


def cell_sizes(mesh: MeshTet) -> FloatArray:
    """Edge of the cube with six times the volume of each tetrahedron, shape (m,) [mm]."""
    corners = mesh.p.T[mesh.t.T]
    return np.cbrt(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])))


def _integral_of_square(values: FloatArray, measures: FloatArray) -> FloatArray:
    """∫ |v|² over simplices, exact for linear v with values (n, d + 1, k) at the corners."""
    corners = values.shape[1]
    total = (values**2).sum(axis=(1, 2)) + (values.sum(axis=1) ** 2).sum(axis=1)
    return measures / (corners * (corners + 1)) * total


def _middles(n: int) -> FloatArray:
    """Barycentric coordinates of the middles of n² equal parts of a triangle, shape (n², 3)."""
    upward = [(i + 1 / 3, j + 1 / 3, n - i - j - 2 / 3) for i in range(n) for j in range(n - i)]
    downward = [(i + 2 / 3, j + 2 / 3, n - i - j - 4 / 3) for i in range(n - 1) for j in range(n - 1 - i)]
    return np.array(upward + downward) / n
