"""Learns the two maps of finite strain from few samples whose displacements are known."""

from dataclasses import fields, replace
from typing import TYPE_CHECKING

import numpy as np

from dataset.measurement import ReadingError
from dataset.resistance import largest_strains, pillar_lengths
from dataset.samples import ENOUGH, SampleError, Samples
from decoupler.data.columns import COMPONENTS, Columns, Resting
from decoupler.data.usual_loads import loads_of_samples
from decoupler.inverse.posterior import Posterior
from decoupler.inverse.sensor_model import SensorModel
from decoupler.inverse.strain_maps import N_AXES, N_CURVED, N_FEATURES, SCALES, StrainMaps, neighbours
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.ensemble import Ensemble
from decoupler.model.settings import NetworkConfig, Progress, TrainingConfig
from decoupler.solve import ridge, ridge_left_out
from decoupler.training.fitting import fitted_network
from decoupler.training.suited import Prepared
from geometry.design import SensorDesign
from geometry.layout import FloatArray, Layout

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse

EVERYTHING = COMPONENTS["all"]  #: finite strain mixes all forces
RIDGES = (1e-5, 1e-4, 1e-3)  #: per row, of features whose root mean squares are their `SCALES`
ENOUGH_ROWS = 2  #: equations a feature, from which on images in a mirror are left out
TINY = 1e-100  #: instead of 0, the size of features of neighbours that no pad has
FLIPPED = np.array([1.0, -1.0, 1.0])  #: sign of x, y and z in a mirror at y = 0
ALIKE = 1e-9  #: largest difference of a mirrored influence, relative
MOST_LOADS = 600  #: most loads of samples that a posterior keeps
DRAWS = 27_000  #: loads that are drawn to train the network that starts; some strain the array too much
HIDDEN = 60  #: hidden nodes of that network
STATE_RIDGE = 1e-3  #: of the linear way from forces to states, over the number of samples
LIGHTER = 10  #: one of so many draws is lighter
JUDGED = 4000  #: draws that say how the network errs
TRUST = 3.0  #: factor of the network's errors as a prior: it has seen the same readings
CHUNK_STATES = 256  #: states worked on together
ROUNDS, MIN_GROWTH = 5, 0.1  #: of fits of the misfit's growth, and its least value at rest


def states_of(displacement_mm: FloatArray, electrodes_mm_per_n: FloatArray) -> FloatArray:
    """Forces (n, 3 k) [N] that would move the linear array's electrodes nearest to displacements (n, k, e, 3) [mm].

    `electrodes_mm_per_n` (3 k, 3 k e) is the influence of forces on them, as in `SensorModel` by eq. 1.
    """
    moved = displacement_mm.reshape(len(displacement_mm), -1, 3).swapaxes(1, 2)
    return moved.reshape(len(moved), -1) @ np.linalg.pinv(electrodes_mm_per_n)


def posterior_of(response: "ArrayResponse", data: Samples) -> Posterior:
    """The posterior of a design at finite strain before any network answers first.

    Its forward model is the response's with what samples at finite strain, of all forces and pillars, add to it. They
    are of a sensor as designed; without displacements they are a `SampleError`.

    Notes
    -----
    Every unit of every sample is one equation for each of its forces and pillars, by ridge regression, each feature
    scaled to `SCALES`; the ridge is the one with the least errors had each equation been left out. Where the array is
    its own image in a mirror at y = 0, electrodes included, so are the forces that deform it, and few samples count
    twice. Its pillars are not: only by eq. 1 their lengths are known in the mirror, too.
    """
    if "twin" in data.made_from:
        raise SampleError(
            "samples of a twin hold no displacements: its own decoder has learned finite strain; take that one."
        )
    if data.displacement_mm is None:
        raise SampleError(
            "samples at finite strain hold no displacements (displacement_mm), which say how the rubber is deformed: "
            "keep them in the file."
        )
    forward = SensorModel.of(response, EVERYTHING)
    design, layout = response.design, response.design.unit.layout
    body = replace(response, design=replace(design, unit=design.unit.body), conducted=None)
    electrodes = SensorModel.of(body, EVERYTHING).influence
    rows, cols = design.array.rows, design.array.cols
    columns, state_n = Columns.of(data, EVERYTHING), states_of(data.displacement_mm, electrodes)
    n_values = N_AXES + forward.n_pillars // (rows * cols)
    moved = _moved(state_n, electrodes, rows, cols)
    empty = StrainMaps(
        influence=electrodes,
        near=neighbours(rows, cols),
        sizes=np.concatenate(
            [each.reshape(-1, N_AXES).std(axis=0) for each in (state_n, moved[..., 0, :], moved[..., -1, :])]
        ),
        weights=np.zeros((N_FEATURES, n_values)),
        misfit=np.zeros(n_values),
        growth=np.array([1.0, 0.0]),
    )
    lengths_mm = data.length_mm if data.effective_length_mm is None else data.effective_length_mm
    if lengths_mm is None:
        squares = forward.squares_of(columns.resistance_ohm)
    else:
        squares = lengths_mm.reshape(len(data), -1) ** 2
    states, forces, lengths2 = [state_n], [columns.force_n], [squares]
    images, few = _images(layout), state_n.size // N_AXES < ENOUGH_ROWS * N_CURVED
    if few and images is not None and _is_mirrored(electrodes, images, rows, cols):
        states.append(_image(state_n, rows, cols))
        forces.append(_image(columns.force_n, rows, cols))
        if response.conducted is None and data.length_mm is not None:
            seen_mm = pillar_lengths(_moved_image(data.displacement_mm, images), design.unit)
            lengths2.append(seen_mm.reshape(len(data), -1) ** 2)
    A = np.concatenate([empty.features(part).reshape(-1, N_FEATURES)[:, :N_CURVED] for part in states])
    scale = SCALES / np.maximum(np.sqrt((A**2).mean(axis=0)), TINY)
    A *= scale
    off_n = np.concatenate(forces) - np.concatenate(states)
    off_mm2 = [own - forward.squares(forward.vectors(part)) for part, own in zip(states, lengths2, strict=False)]
    is_loaded = np.array([not one.reference for one in layout.pillars])
    targets = [off_n.reshape(-1, N_AXES), np.concatenate(off_mm2).reshape(-1, n_values - N_AXES) * is_loaded]
    if len(targets[0]) == len(targets[1]):
        targets = [np.concatenate(targets, axis=1)]
    found = [ridge_left_out(A[: len(part)], part, RIDGES) for part in targets]
    weights = np.zeros_like(empty.weights)
    weights[:N_CURVED] = scale[:, None] * np.concatenate([own for own, _ in found], axis=1)
    left_out = np.concatenate([left[: state_n.size // N_AXES] for _, left in found], axis=1)
    misfit = np.sqrt((left_out**2).mean(axis=0))
    s = (empty.own(state_n) ** 2).mean(axis=2).ravel()
    told = misfit > 0  # not of references
    growth = _growth(s**2, ((left_out / np.where(told, misfit, np.inf)) ** 2).mean(axis=1) / told.mean())
    maps = replace(empty, weights=weights, misfit=misfit, growth=growth)
    to_state = ridge(np.column_stack([columns.force_n, np.ones(len(data))]), state_n, STATE_RIDGE * len(data))
    return Posterior(
        forward=replace(forward, maps=maps),
        to_state=to_state,
        precision=np.zeros([columns.force_n.shape[1]] * 2),
        loads_n=columns.force_n[:MOST_LOADS],
    )


def _moved(force_n: FloatArray, electrodes_mm_per_n: FloatArray, rows: int, cols: int) -> FloatArray:
    """Displacements (n, rows, cols, e, 3) [mm] of the linear array's electrodes under forces (n, 3 k) [N]."""
    return (force_n @ electrodes_mm_per_n).reshape(len(force_n), 3, rows, cols, -1).transpose(0, 2, 3, 4, 1)


def _images(layout: Layout) -> list[int] | None:
    """Number of each upper electrode's image in a mirror at y = 0; None if one of them has none."""
    places = [one.place for one in layout.upper]
    images = [(x, -y) for x, y in places]
    return [places.index(image) for image in images] if set(images) <= set(places) else None


def _is_mirrored(electrodes_mm_per_n: FloatArray, images: list[int], rows: int, cols: int) -> bool:
    """Whether mirrored forces move the linear array's electrodes as the mirror shows."""
    unit = np.eye(len(electrodes_mm_per_n))
    seen = _moved(_image(unit, rows, cols), electrodes_mm_per_n, rows, cols)
    image = _moved_image(_moved(unit, electrodes_mm_per_n, rows, cols), images)
    return np.allclose(seen, image, atol=ALIKE * np.abs(seen).max())


def _image(force_n: FloatArray, rows: int, cols: int) -> FloatArray:
    """Forces or states (n, 3 k) [N] as a mirror at y = 0 shows them."""
    return (force_n.reshape(-1, rows, cols, N_AXES)[:, ::-1] * FLIPPED).reshape(force_n.shape)


def _moved_image(displacement_mm: FloatArray, images: list[int]) -> FloatArray:
    """Displacements (n, rows, cols, e, 3) [mm] as a mirror at y = 0 shows them, where electrodes are their images."""
    return displacement_mm[:, ::-1, :, images] * FLIPPED


def _growth(x: FloatArray, squares: FloatArray) -> FloatArray:
    """a, b ≥ 0 of squares ≈ a + b x, each (n,), as likely as may be for squares of normal numbers."""
    from scipy.optimize import nnls

    found = np.array([1.0, 0.0])
    for _ in range(ROUNDS):  # least squares, weighted by what the last round expects
        expected = found[0] + found[1] * x
        found = nnls(np.column_stack([np.ones_like(x), x]) / expected[:, None], squares / expected)[0]
        found[0] = max(found[0], MIN_GROWTH)
    return found


def drawn_samples(
    posterior: Posterior,
    loads_n: FloatArray,
    design: SensorDesign,
    errors: ReadingError,
    ensemble: Ensemble | None = None,
) -> Columns:
    """Samples drawn from a sensor at finite strain as it would show them, or from an ensemble of such.

    `loads_n` (n, 3 k) [N] are like those that the sensor meets. Those that strain it by more than the posterior's do
    are left out, `ENOUGH` at most are kept, and a tenth is made lighter.

    Notes
    -----
    A draw's state is the one to which its load leads to first order, with what that leaves of another's own; its
    forces and resistances are then those of that state, whatever load it was drawn for.
    """
    forward, generator = posterior.forward, np.random.default_rng(0)
    maps, n = forward.maps, len(loads_n)
    assert maps is not None
    known_n = maps.nearest_states(posterior.loads_n)[0]
    left_n = known_n - np.column_stack([posterior.loads_n, np.ones(len(known_n))]) @ posterior.to_state
    states = np.column_stack([loads_n, np.ones(n)]) @ posterior.to_state
    states += left_n[generator.integers(len(left_n), size=n)]
    states = states[strains_in(maps, states, design) <= strains_in(maps, known_n, design).max()][:ENOUGH]
    states *= np.where(np.arange(len(states)) % LIGHTER, 1.0, generator.uniform(0.0, 1.0, len(states)))[:, None]
    squares, force_n = [], []
    for part in np.array_split(states, max(1, len(states) // CHUNK_STATES)):
        values = maps.values(part)
        y = forward.linear.lengths(part) ** 2 + values[..., N_AXES:].reshape(len(part), -1)
        y += np.sqrt(posterior.squares_variance(part)) * generator.standard_normal(y.shape)
        if ensemble is not None:
            factors = ensemble.factors(forward, part)
            unsure_ohm = factors @ generator.standard_normal((len(part), factors.shape[2], 1))
            y += unsure_ohm[..., 0] / forward.ohm_per_mm2
        squares.append(y)
        force_n.append(part + values[..., :N_AXES].reshape(part.shape))
    y, forces = np.concatenate(squares), np.concatenate(force_n)
    possible = (y > 0).all(axis=1)
    y, forces = y[possible], forces[possible]
    ohms = forward.ohms(y).reshape(len(y), design.array.rows, design.array.cols, -1)
    return Columns(
        component=EVERYTHING,
        shape=(design.array.rows, design.array.cols),
        resistance_ohm=errors.read(ohms, generator).reshape(y.shape),
        force_n=forces,
        load=np.arange(len(forces)),
        errors=errors,
        dead=np.zeros(ohms.shape[1:], dtype=bool),
        layout=design.unit.layout,
    )


def strains_in(maps: StrainMaps, state_n: FloatArray, design: SensorDesign) -> FloatArray:
    """Largest strain of a pillar in states, (n, 3 k) [N] -> (n,)."""
    moved = _moved(state_n, maps.influence, design.array.rows, design.array.cols)
    return largest_strains(moved.reshape(len(moved), design.n_units, -1, 3), design.unit)


def trained_at_strain(
    data: Samples, response: "ArrayResponse", training: TrainingConfig, progress: Progress
) -> DecouplerAtStrain:
    """The decoupler of an array at finite strain, from samples of it as designed, which hold displacements.

    It is trained for loads like theirs.
    """
    posterior, design = posterior_of(response, data), response.design
    loads_n = loads_of_samples(data, DRAWS).reshape(DRAWS, -1)
    return refined(posterior, loads_n, design, data.errors, training=training, progress=progress)


def refined(
    posterior: Posterior,
    loads_n: FloatArray,
    design: SensorDesign,
    errors: ReadingError,
    ensemble: Ensemble | None = None,
    training: TrainingConfig | None = None,
    progress: Progress = lambda *_: None,
) -> DecouplerAtStrain:
    """A network that is trained on draws, and the posterior that takes its answers as start and prior. Loads torch.

    Arguments are as of `drawn_samples`.
    """
    drawn = drawn_samples(posterior, loads_n, design, errors, ensemble)
    form, training = NetworkConfig(hidden=HIDDEN, feature="root"), training or TrainingConfig()
    net = fitted_network(Prepared(columns=drawn, form=form, training=training, design=design), progress)
    off_n = net.outputs(drawn.resistance_ohm[:JUDGED]) - drawn.force_n[:JUDGED]
    precision = np.linalg.inv(TRUST**2 * (off_n.T @ off_n) / len(off_n)).astype(np.float64)
    resting = Resting.read_with(posterior.forward.at_rest_ohm(), drawn.errors.bits)
    told = vars(net) | {"front": replace(net.front, resting=resting)}
    parts = {spec.name: told[spec.name] for spec in fields(net)}
    return DecouplerAtStrain(**parts, posterior=replace(posterior, precision=precision))
