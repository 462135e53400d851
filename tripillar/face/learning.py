"""Make samples, and train, test and tune networks on them."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from geometry.design import SensorDesign
from tripillar.face.bodies import response

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.evaluation.assessment import Assessment
    from decoupler.evaluation.metrics import ForceErrors
    from decoupler.model.decoupler import Decoupler
    from decoupler.model.settings import Net, Trainer
    from fem.array.response import ArrayResponse

Component = Literal["fz", "fx", "fy", "all"]
Feature = Literal["auto", "inverse", "root", "resistance"]


def simulate(
    sensor: "SensorDesign | ArrayResponse | None" = None,
    protocol: str = "three-axis",
    samples: int = 1000,
    *,
    seed: int = 0,
    noise: float = 0.0,
    bits: int | None = None,
    **settings: Any,
) -> "Samples":
    """Simulate labelled samples: forces on the pads, and the resistances they give.

    Parameters
    ----------
    sensor : SensorDesign or ArrayResponse, optional
        Default: the paper's sensor.
    protocol : str
        Kind of loads: independent-fz, independent-fx, contact-fz, contact-fx, contact, three-axis, light-fz, light-fx
        or light.
    samples : int
        Number of samples.
    seed : int
        Seed of the random loads and noise.
    noise : float
        Standard deviation of a reading, relative to the resistance.
    bits : int, optional
        Bits of the converter; default: exact readings.
    **settings
        Further fields of `dataset.DatasetSettings`, such as cap, gain_spread, offset_ohm or dead_pillars.

    Returns
    -------
    Samples
        ``force_n`` and ``resistance_ohm``, shape (samples, rows, cols, 3), and what lies between.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = tp.simulate(design, "contact", 50, noise=0.001, bits=12, gain_spread=0.1)
    >>> len(samples), samples.resistance_ohm.shape
    (50, (50, 1, 2, 3))
    """
    import dataset

    asked = dataset.DatasetSettings(protocol=protocol, samples=samples, seed=seed, noise=noise, bits=bits, **settings)
    return dataset.simulate(response(sensor) if sensor is None or isinstance(sensor, SensorDesign) else sensor, asked)


def train(
    samples: "Samples",
    component: Component | None = None,
    *,
    net: "Net" = "skip",
    hidden: int = 17,
    trainer: "Trainer" = "varpro",
    feature: Feature = "auto",
    seed: int = 0,
    design: SensorDesign | None = None,
    force: bool = False,
    **settings: Any,
) -> "Decoupler":
    """Train a network that turns resistances into forces.

    Parameters
    ----------
    samples : Samples
        Simulated or measured; leave those for tests out.
    component : str, optional
        Forces that the network tells: fz, fx, fy or all; default: those that act.
    net : str
        ``plain``, as in the paper, or ``skip`` with a linear map past the hidden layer.
    hidden : int
        Number of hidden nodes.
    trainer : str
        ``varpro`` (variable projection), ``lm`` (Levenberg-Marquardt) or ``momentum``, the paper's.
    feature : str
        Inputs of the network: ``inverse`` (of the response, solved for if need be), ``root`` (√R) or ``resistance``;
        ``auto`` takes the inverse if the response explains the samples, else √R.
    seed : int
        Seed of the random start.
    design : SensorDesign, optional
        Of samples that state none; default: the paper's, if its array has their size.
    force : bool
        True trains although the samples look wrong; the model remembers why they did.
    **settings
        Further fields of `decoupler.TrainingConfig`, such as goal_mse or max_iterations.

    Returns
    -------
    Decoupler
        ``forces(resistance_ohm)`` gives forces [N], ``half_widths(resistance_ohm)`` those [N] that hold
        68 % and 95 % of their errors.

    Raises
    ------
    SampleError
        If the samples look wrong or cannot train a network.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = tp.simulate(design, samples=200, noise=0.001)
    >>> model = tp.train(samples, hidden=4)
    >>> model.component.name, model.network.feature
    ('all', 'inverse')
    >>> half_width_n, _ = model.half_widths(samples.resistance_ohm)
    >>> off_n = abs(model.forces(samples.resistance_ohm) - samples.force_n)
    >>> bool(0.6 < (off_n < half_width_n).mean() < 0.76)
    True
    """
    from tripillar.pipeline.data_checks import Caller
    from tripillar.pipeline.learning import train_checked

    parts, network, training = _asked(samples, component, net, hidden, feature, trainer, seed, settings)
    return train_checked(
        samples, parts, network, training, automatic=feature == "auto", design=design, force=force, caller=Caller()
    )[0]


def evaluate(model: "Decoupler", samples: "Samples", *, limits: bool = True) -> "dict[str, Assessment]":
    """Errors of a model on samples that it has not seen, beside what the readings allow.

    Parameters
    ----------
    model : Decoupler
    samples : Samples
    limits : bool
        False leaves the limits out, for which the response is solved if need be.

    Returns
    -------
    dict of Assessment
        By force: ``errors`` (rel_err, rmse_n, full_scale_pct), ``limits``, ``ratio`` of error and limit, and more.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> model = tp.train(tp.simulate(design, samples=1000, seed=1, noise=0.001), hidden=4)
    >>> found = tp.evaluate(model, tp.simulate(design, samples=100, seed=2, noise=0.001))
    >>> list(found), found["fz"].ratio < 1.15
    (['fx', 'fy', 'fz'], True)
    """
    from tripillar.pipeline.data_checks import Caller
    from tripillar.pipeline.learning import assess_checked

    return assess_checked(model, samples, limits, Caller())


def crossval(
    samples: "Samples",
    component: Component | None = None,
    folds: int = 10,
    *,
    net: "Net" = "skip",
    hidden: int = 17,
    trainer: "Trainer" = "varpro",
    feature: Feature = "auto",
    seed: int = 0,
    design: SensorDesign | None = None,
    force: bool = False,
    **settings: Any,
) -> "dict[str, ForceErrors]":
    """Cross-validate: test every sample once, by a network that never saw it; folds in parallel processes.

    These processes import the program that calls: it calls below ``if __name__ == "__main__":``.

    Parameters
    ----------
    samples : Samples
    folds : int
        Number of parts, each tested once.
    component, net, hidden, trainer, feature, seed, design, force, **settings
        As of `train`.

    Returns
    -------
    dict of ForceErrors
        By force, the mean over the folds: rel_err, rmse_n, full_scale_pct.

    Examples
    --------
    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = tp.simulate(design, "contact-fz", 60)
    >>> tp.crossval(samples, folds=2, hidden=4)["fz"].rel_err < 0.0261  # the paper's of ten folds of 2000
    True
    """
    import numpy as np

    from decoupler.evaluation.crossval import over_folds
    from tripillar.pipeline.data_checks import Caller
    from tripillar.pipeline.learning import cross_validate_checked

    parts, network, training = _asked(samples, component, net, hidden, feature, trainer, seed, settings)
    _, tested = cross_validate_checked(
        samples, parts, network, training, folds,
        automatic=feature == "auto", design=design, force=force, caller=Caller(),
    )  # fmt: skip
    return over_folds(tested, np.mean)


def fine_tune(model: "Decoupler", pairs: "Samples", *, force: bool = False) -> "Decoupler":
    """Fit a model to one real sensor by a few measured pairs of forces and resistances.

    Parameters
    ----------
    model : Decoupler
        Trained on simulated samples.
    pairs : Samples
        Measured on the sensor.
    force : bool
        True goes on although the pairs look wrong; the model remembers why they did.

    Raises
    ------
    SampleError
        If the pairs look wrong or are too few.

    Examples
    --------
    A sensor whose pillars differ by 10 % from the design:

    >>> import tripillar as tp
    >>> from dataclasses import replace
    >>> design = tp.SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> model = tp.train(tp.simulate(design, samples=200, seed=1, noise=0.001), hidden=4)
    >>> own = tp.simulate(design, samples=120, seed=2, noise=0.001, gain_spread=0.1)
    >>> tuned = tp.fine_tune(model, own[:20])
    >>> before, after = (tp.evaluate(one, own[20:], limits=False)["fz"].errors.rmse_n for one in (model, tuned))
    >>> after < before / 5
    True
    """
    from tripillar.pipeline.data_checks import Caller
    from tripillar.pipeline.learning import fine_tune_checked

    return fine_tune_checked(model, pairs, force, Caller())


def _asked(
    samples: "Samples",
    component: Component | None,
    net: "Net",
    hidden: int,
    feature: Feature,
    trainer: "Trainer",
    seed: int,
    settings: dict[str, Any],
) -> tuple[str, Any, Any]:
    """Component, network and training as plain arguments ask for them."""
    from dataset.samples import require_samples
    from decoupler.model.settings import NetworkConfig, TrainingConfig
    from decoupler.training.suited import suited_component

    require_samples("samples", samples)
    network = NetworkConfig(hidden=hidden, net=net)
    if feature != "auto":
        network = replace(network, feature=feature)
    return component or suited_component(samples), network, TrainingConfig(trainer=trainer, seed=seed, **settings)
