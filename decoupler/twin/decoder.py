"""From the posterior of a sensor to the decoder of its forces, made for readings drawn from that posterior."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dataset.measurement import ReadingError
from decoupler.data.columns import Columns
from decoupler.data.usual_loads import light_loads
from decoupler.inverse.posterior import Posterior
from decoupler.inverse.sensor_model import ModelInverse
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoupler import Decoupler
from decoupler.model.front import Front
from decoupler.model.settings import NetworkConfig
from decoupler.model.usual import UsualLoads
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.solve import best_ridge, ridge
from decoupler.training.error_bars import with_uncertainty
from decoupler.training.finite_strain import refined
from decoupler.training.one_layer import Skip
from decoupler.twin.posterior import Specimen
from geometry.design import SensorDesign
from geometry.layout import FloatArray, Layout


def decoder_of(
    found: Specimen,
    loads_n: FloatArray,
    errors: ReadingError,
    dead: NDArray[np.bool_],
    layout: Layout,
    design: SensorDesign,
) -> Decoupler:
    """The decoder of linear rubber that errs least, in the mean square, on sensors of the posterior under usual loads.

    `loads_n` (n, Q) are usual loads [N], to which rest and light touches are added, `errors` those of the readings that
    it will take, `dead` (rows, cols, n_pillars) pillars that are not read.

    Notes
    -----
    The inverse of the most probable response, then a linear map of its forces by ridge regression, fitted to readings
    of the posterior's sensors: the more these differ, or the noisier they read, the nearer to the usual loads.
    """
    generator, forward, size = np.random.default_rng(0), found.sensor, (dead.shape[0], dead.shape[1])

    def read(force_n: FloatArray) -> FloatArray:
        drawn = found.ensemble.readings(forward, force_n, np.arange(len(force_n)) % len(found.ensemble))
        return np.maximum(errors.scattered(drawn, *size, generator), MIN_WHOLE_OHM)

    light_n = light_loads(loads_n, generator)
    force_n = np.concatenate([loads_n, light_n])
    data = Columns(
        component=found.expected.component,
        shape=size,
        resistance_ohm=read(force_n),
        force_n=force_n,
        load=np.arange(len(force_n)),
        errors=errors,
        dead=dead,
        layout=layout,
    )
    missed = data.resistance_ohm / forward.resistances(force_n) - 1.0
    unsure = float(np.sqrt(np.mean(missed[:, data.readable] ** 2)))
    inverse = ModelInverse.about(
        forward, loads_n, data.readable, unsure, lambda some_n: forward.lengths_of(read(some_n))
    )
    front = Front.of(data, inverse, data.force_scaling)
    inputs = front.inputs(data.resistance_ohm)
    A, missing = np.column_stack([inputs, np.ones(len(inputs))]), data.force_scaling.scale(force_n) - inputs
    penalty = best_ridge(A, missing)
    network = Skip(hidden=np.empty((0, A.shape[1])), output=ridge(A, missing, penalty).T).beside_inputs()
    form = NetworkConfig(hidden=0, net="skip", feature="inverse")
    trained = replace(
        Decoupler.of(data, form, front, network, design),
        usual=UsualLoads.of(data[: len(loads_n)]),
        ensemble=found.ensemble,
    )
    return with_uncertainty(trained, data, inputs, penalty, len(light_n))


def decoder_at_strain(
    found: Specimen, designed: Posterior, loads_n: FloatArray, errors: ReadingError, design: SensorDesign
) -> DecouplerAtStrain:
    """The decoder at finite strain: a network trained on the posterior's sensors, refined by that of the forces.

    `designed` is the posterior of forces on the design; other arguments are as of `decoder_of`.
    """
    own = replace(designed, forward=found.sensor, misfit=found.expected.widths.misfit)
    return replace(refined(own, loads_n, design, errors, found.ensemble), ensemble=found.ensemble)
