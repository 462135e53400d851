"""The loads that a sensor is expected to meet, which its decoder is made for."""

import numpy as np

from dataset.loads import PAPERS, Loads
from dataset.protocols import MAX_TOUCHED, PROTOCOLS, forces
from dataset.samples import Samples
from geometry.design import SensorDesign
from geometry.layout import AXES, FloatArray

#: sign of forces along x, y, z in the mirrors across x and y, which turn columns and rows around
MIRRORED = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0))
SPREAD = 0.5  #: standard deviation of the logarithm of a load's size, if only one was measured

LIGHT = 0.1  #: number of light loads, over that of the samples
TOUCH = 0.05  #: force of a light touch, over the largest force
ENOUGH_LOADS = 100  #: loads that say more of the usual ones than a protocol like them
ALIKE = (0.3, 1.5)  #: range of the mean squared distance of loads from a protocol's; 0.5 to 1.2 if drawn from it
RIDGE = 1e-3  #: of the covariance of a protocol's loads, over its mean variance


def usual_loads(protocol: str, design: SensorDesign, count: int, loads: Loads = PAPERS) -> FloatArray:
    """Random loads of a protocol within these ranges, (count, rows, cols, 3) [N]."""
    newtons = forces(PROTOCOLS[protocol].draw(np.random.default_rng(0), count, design, loads), design)
    return newtons.reshape(count, design.array.rows, design.array.cols, len(AXES))


def loads_of_samples(data: Samples, count: int) -> FloatArray:
    """Loads (count, rows, cols, 3) [N] like those of samples: of the protocol that drew them, or images of theirs."""
    protocol = str(data.made_from.get("protocol"))
    if protocol not in PROTOCOLS or data.design is None:
        return images_of(data.force_n, list(range(len(AXES))), count)
    return usual_loads(protocol, data.design, count, data.loads)


def loads_like(
    force_n: FloatArray, axes: list[int], design: SensorDesign, count: int, ranges: Loads = PAPERS
) -> FloatArray | None:
    """Loads (count, rows, cols, 3) [N] of the protocol that given ones, (n, rows, cols, 3), look drawn from, if any.

    Notes
    -----
    The likeliest protocol by normal distributions of its mean and covariance, if the loads' mean squared Mahalanobis
    distance, over its degrees of freedom, is in `ALIKE`. Few loads say little of how all pads are loaded together, and
    a protocol says it all.
    """
    if len(force_n) >= ENOUGH_LOADS:
        return None
    found, best = None, -np.inf
    given = force_n[..., axes].reshape(len(force_n), -1)
    for name, protocol in PROTOCOLS.items():
        if protocol.is_light or [AXES.index(axis) for axis in protocol.axes] != axes:
            continue
        loads = usual_loads(name, design, count, ranges)
        columns = loads[..., axes].reshape(count, -1)
        covariance = np.cov(columns.T, bias=True).reshape(given.shape[1], -1)
        covariance.flat[:: len(covariance) + 1] += RIDGE * np.trace(covariance) / len(covariance)
        off = given - columns.mean(axis=0)
        distance = np.mean(np.einsum("nq,qn->n", off, np.linalg.solve(covariance, off.T))) / given.shape[1]
        likelihood = -distance - np.linalg.slogdet(covariance)[1] / given.shape[1]
        if likelihood > best:
            found, best = loads if ALIKE[0] < distance < ALIKE[1] else None, likelihood
    return found


def images_of(force_n: FloatArray, axes: list[int], count: int) -> FloatArray:
    """Loads (count, rows, cols, k) [N] like those given, (n, rows, cols, k): themselves, then images of them.

    `axes` are the numbers of the k axes of forces.

    An image is a load moved along the array, as if mirrored at the rims, and mirrored across x, y or both: a load may
    act anywhere and in any direction, whichever few were measured. Its size differs by `SPREAD`/√n: n loads say no more
    of how large loads are. Nor do one or two say how pads are loaded together: 1/(1 + n²) of the images have the force
    of each pad from a pad of its own.
    """
    n, rows, cols, _ = force_n.shape
    if n >= count:
        return force_n[np.linspace(0, n - 1, count).astype(int)]
    generator = np.random.default_rng(0)
    whose = np.arange(count) % n
    turned = generator.random((count, 2)) < 0.5
    moved = generator.integers((rows + 1, cols + 1), size=(count, 2))
    size = np.exp(SPREAD / np.sqrt(n) * generator.standard_normal(count))
    alone = np.flatnonzero(generator.random(count) < 1.0 / (1.0 + n**2))
    alone = alone[alone >= n]
    places, signs = [], np.ones((count, len(axes)))
    for axis, length in enumerate((rows, cols)):
        place = moved[:, axis, None] + np.arange(length)
        place = np.where(place < length, place, 2 * length - 1 - place)
        places.append(np.where(turned[:, 1 - axis, None], place[:, ::-1], place))
        signs[turned[:, axis]] *= np.array(MIRRORED[axis])[axes]
    found = force_n[whose[:, None, None], places[0][:, :, None], places[1][:, None]] * signs[:, None, None]
    pads = found[alone].reshape(len(alone), rows * cols, len(axes))
    others = generator.integers(rows * cols, size=(len(alone), rows * cols))
    found[alone] = np.take_along_axis(pads, others[..., None], axis=1).reshape(-1, rows, cols, len(axes))
    found *= size[:, None, None, None]
    found[:n] = force_n
    return found


def light_loads(force_n: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Light loads (m, n_forces) [N] beside those of training, (n, n_forces).

    A quarter of them is rest; in each, none to `MAX_TOUCHED` forces are up to `TOUCH` of the largest in training.
    """
    n, n_forces = max(round(LIGHT * len(force_n)), 4), force_n.shape[1]
    touched = generator.random((n, n_forces)).argsort(axis=1) < generator.integers(0, MAX_TOUCHED + 1, (n, 1))
    low, high = np.minimum(force_n.min(axis=0), 0.0), np.maximum(force_n.max(axis=0), 0.0)
    return touched * TOUCH * generator.uniform(low, high, (n, n_forces))
