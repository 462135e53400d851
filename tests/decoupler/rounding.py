"""What rounding to float does to a model's forces, foretold from the sizes of its weights."""

import numpy as np

from decoupler.export.portable import output_weights_n
from decoupler.model.decoupler import Decoupler
from geometry.layout import FloatArray

HALF_BIT = 2.0**-24  #: of a float: the largest relative error of one rounding
SPREAD = 1.0 / np.sqrt(3.0)  #: standard deviation of an error that is uniform in ± 1
SURELY = 5.0  #: standard deviations; one normal number in two million is beyond


def float_rounding_n(model: Decoupler, resistance_ohm: FloatArray) -> FloatArray:
    """Largest difference [N] that roundings to float explain, of the shape of ``model.forces(resistance_ohm)``.

    Notes
    -----
    Roundings are independent and uniform, so that variances add up, through the derivatives, to first order: of the
    resistance, of every constant, of every result, and of each product and partial sum of a product of matrices. Of the
    response's inverse the last correction counts; what was rounded before it, it corrects. Counted are errors in units
    of `HALF_BIT`.
    """
    ohms = ohms_error = model.columns(resistance_ohm)
    if model.inverse is not None:
        x = model.inverse.forces(ohms)
        D = model.inverse.derivatives(ohms)
        whole = ohms - model.inverse.forward.offset_ohm
        length_error = _length_error(model, ohms, whole, x)
        by_length = D * (2.0 * whole / model.inverse.forward.lengths_of(ohms))[:, None]
        x_error = _together(x, np.sqrt(np.einsum("nfp,np->nf", by_length**2, length_error**2)))
    elif model.network.feature == "root":
        x = np.sqrt(ohms)
        x_error = _together(0.5 * ohms_error / x, x)
    else:
        x, x_error = ohms, ohms_error
    scaling = model.input_scaling
    scaled = scaling.scale(x)
    inputs = np.column_stack([scaled, np.ones(len(x))])
    scaled_error = _together(x_error * scaling.factor, scaling.centre * scaling.factor, scaled, scaled, scaled)
    inputs_error = np.column_stack([scaled_error, np.zeros(len(x))])
    hidden = np.tanh(inputs @ model.hidden_weights.T)
    hidden_error = _together((1.0 - hidden**2) * _affine_error(inputs, inputs_error, model.hidden_weights), hidden)
    rest = slice(None) if model.network.net == "skip" else slice(-1, None)
    seen = np.hstack([hidden, inputs[:, rest]])
    seen_error = np.hstack([hidden_error, inputs_error[:, rest]])
    error = _affine_error(seen, seen_error, output_weights_n(model))
    shape = (-1, model.rows, model.cols, len(model.component.axes))
    return (SURELY * SPREAD * HALF_BIT * error).reshape(shape)


def _length_error(model: Decoupler, ohms: FloatArray, whole: FloatArray, force_n: FloatArray) -> FloatArray:
    """Error of √((R − o) / c) − |d + B F|, (n, n_pillars) [mm]; `whole` is R − o."""
    forward = model.inverse.forward
    lengths, vectors = forward.lengths_of(ohms), forward.vectors(force_n)
    moved = 2.0 * (force_n**2 @ forward.influence**2)  # B and products; partial sums are smaller than the whole
    moved = moved.reshape(len(ohms), len(forward.rest_mm), -1)[:, :, forward.top]
    along = 2.0 * vectors**2 + forward.rest_mm**2 + moved
    whole_error = _together(ohms, forward.offset_ohm, whole)
    measured = _together(0.5 * lengths * whole_error / whole, 0.5 * lengths, 0.5 * lengths, lengths)
    modelled = _together(np.sqrt(((vectors / lengths[:, None]) ** 2 * along).sum(axis=1)), 0.5 * lengths, lengths)
    return _together(measured, modelled)


def _affine_error(x: FloatArray, x_error: FloatArray, weights: FloatArray) -> FloatArray:
    """Error of ``x @ weights.T`` with rounded weights; partial sums are held to be the whole or one product."""
    results = (x @ weights.T) ** 2
    return np.sqrt((x_error**2 + 3.0 * x**2) @ weights.T**2 + results)


def _together(*errors: FloatArray) -> FloatArray:
    return np.sqrt(sum(error**2 for error in errors))
