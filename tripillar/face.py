"""What `import tripillar` gives: each job of the command line as a function, with good defaults.

Responses come from the cache that the commands use, too. Every function loads its stage when it is called.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from geometry.design import SensorDesign
from geometry.errors import ArgumentError

if TYPE_CHECKING:
    from dataset.samples import Samples
    from decoupler.evaluation.assessment import Assessment
    from decoupler.evaluation.metrics import ForceErrors
    from decoupler.model.decoupler import Decoupler
    from decoupler.model.settings import Net, Trainer
    from fem.array.response import ArrayResponse
    from fem.scene.scene import Scene
    from fem.scene.solution import Solution
    from tripillar.viewer.showing import Camera, Colour, LoadKind

Component = Literal["fz", "fx", "fy", "all"]
Feature = Literal["auto", "inverse", "root", "resistance"]


def response(
    design: SensorDesign | None = None,
    *,
    tolerance: float | None = None,
    method: Literal["cells", "layer", "halfspace"] = "cells",
) -> "ArrayResponse":
    """Compute how far a newton on each pad moves each electrode; from the cache if it is there.

    Parameters
    ----------
    design : SensorDesign, optional
        Default: the paper's sensor.
    tolerance : float, optional
        Relative error wanted; default: 1e-3, or 1e-2 with pillars of another rubber than the matrix.
    method : str
        ``cells`` couples copies of one condensed cell; ``layer`` and ``halfspace`` are approximate closed forms.

    Returns
    -------
    ArrayResponse
        ``influence_mm_per_n``, shape (rows, cols, 2, 3, rows, cols, 3): unit, electrode U1 or U2, axis of the
        displacement; unit and axis of the load. ``error_estimate`` is relative.

    Examples
    --------
    >>> design = SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> response(design).influence_mm_per_n.shape
    (1, 2, 2, 3, 1, 2, 3)
    """
    from fem.array.solving import ResponseSettings, array_response

    settings = ResponseSettings(method=method, tolerance=tolerance)
    return array_response(SensorDesign() if design is None else design, settings)[0]


def solve(scene: "Scene | Path | str", *, tolerance: float | None = None) -> "Solution":
    """Solve a scene: a block, pillar, unit or array under loads.

    Parameters
    ----------
    scene : Scene or path
        A scene, or its file (TOML).
    tolerance : float, optional
        Relative error wanted of the probes; default: the scene's.

    Returns
    -------
    Solution
        ``probes`` has the displacement [mm] along x, y, z by the name of the probe; ``error_estimate`` is relative.

    Examples
    --------
    A column without lateral strain shortens by σ h / E:

    >>> from fem.scene.scene_file import scene_from_dict
    >>> top = {"center_mm": [2.0, 2.0], "size_mm": [4.0, 4.0]}
    >>> scene = {
    ...     "body": {"kind": "block", "size_mm": [4.0, 4.0, 10.0]},
    ...     "material": {"young_mpa": 5.0, "poisson": 0.0},
    ...     "load": [{**top, "traction_mpa": [0.0, 0.0, -1.0]}],
    ...     "probe": [{**top, "name": "top", "kind": "mean"}],
    ... }
    >>> round(float(solve(scene_from_dict(scene)).probes["top"][2]), 6)
    -2.0
    """
    from fem.methods.solving import solve_scene
    from fem.scene.scene_file import read_scene

    asked = read_scene(Path(scene)) if isinstance(scene, str | Path) else scene
    return solve_scene(asked if tolerance is None else replace(asked, tolerance=tolerance))[0]


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
    >>> design = SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = simulate(design, "contact", 50, noise=0.001, bits=12, gain_spread=0.1)
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
        ``forces(resistance_ohm)`` gives forces [N], ``deviations(resistance_ohm)`` the half-widths [N] that hold
        68 % and 95 % of their errors.

    Raises
    ------
    SampleError
        If the samples look wrong or cannot train a network.

    Examples
    --------
    >>> design = SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = simulate(design, samples=200, noise=0.001)
    >>> model = train(samples, hidden=4)
    >>> model.component.name, model.network.feature
    ('all', 'inverse')
    >>> half_width_n, _ = model.deviations(samples.resistance_ohm)
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
    >>> design = SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> model = train(simulate(design, samples=1000, seed=1, noise=0.001), hidden=4)
    >>> found = evaluate(model, simulate(design, samples=100, seed=2, noise=0.001))
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
    >>> design = SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> samples = simulate(design, "contact-fz", 60)
    >>> crossval(samples, folds=2, hidden=4)["fz"].rel_err < 0.0261  # the paper's of ten folds of 2000
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

    >>> design = SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> model = train(simulate(design, samples=200, seed=1, noise=0.001), hidden=4)
    >>> own = simulate(design, samples=120, seed=2, noise=0.001, gain_spread=0.1)
    >>> tuned = fine_tune(model, own[:20])
    >>> before, after = (evaluate(one, own[20:], limits=False)["fz"].errors.rmse_n for one in (model, tuned))
    >>> after < before / 5
    True
    """
    from tripillar.pipeline.data_checks import Caller
    from tripillar.pipeline.learning import fine_tune_checked

    return fine_tune_checked(model, pairs, force, Caller())


def write(thing: "SensorDesign | ArrayResponse | Samples | Decoupler", path: Path | str) -> None:
    """Write a file, whole or not at all.

    Parameters
    ----------
    thing : SensorDesign, ArrayResponse, Samples or Decoupler
        A design is written as TOML, a response or samples as NetCDF, a model as its path ends: .onnx, .h (C for a
        microcontroller), else safetensors.
    path : path

    Raises
    ------
    ArgumentError
        If it is something else.
    NotWrittenError
        If the disk is full or the folder may not be written to.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> folder = Path(mkdtemp())
    >>> write(SensorDesign(), folder / "sensor.toml")
    >>> [path.name for path in folder.iterdir()]
    ['sensor.toml']
    """
    from dataset.samples import Samples
    from decoupler.export import export_model
    from decoupler.model.decoupler import Decoupler
    from decoupler.model.model_file import write_model
    from fem.array.response import ArrayResponse, write_response
    from geometry.design_file import write_design

    path = Path(path)
    if isinstance(thing, SensorDesign):
        write_design(thing, path)
    elif isinstance(thing, ArrayResponse):
        write_response(thing, path)
    elif isinstance(thing, Samples):
        thing.write(path)
    elif not isinstance(thing, Decoupler):
        raise ArgumentError(
            f"a {type(thing).__name__} cannot be written: give a design, a response, samples or a model."
        )
    elif path.suffix in (".onnx", ".h"):
        export_model(thing, path)
    else:
        write_model(thing, path)


def view(
    body: "SensorDesign | Scene | Path | str | None" = None,
    save: Path | str | None = None,
    *,
    pressure_mpa: float | Sequence[float] = 3.0,
    load: "LoadKind" = "indenter",
    colour: "Colour" = "displacement",
    scale: float | None = 1.0,
    camera: "Camera" = "iso",
) -> dict[str, float]:
    """Show a sensor or a scene deformed: in a window, or as a file.

    Parameters
    ----------
    body : SensorDesign, Scene or path, optional
        What is shown, or its file (TOML); default: the paper's sensor.
    save : path, optional
        File to write: .png, .html, .mp4 or .vtm; default: open a window.
    pressure_mpa : float or sequence of float
        Pressure at the indenter's middle or on every pad; of several each gets a picture. A scene has its own loads.
    load : str
        ``indenter``, a round one over the middle of the array, or ``uniform``, all pads alike.
    colour : str
        Quantity shown as colour: displacement, vertical, mises or pressure.
    scale : float, optional
        Factor of the displacement as drawn; None chooses one that shows it well.
    camera : str
        Direction to look from: iso, top, front or side.

    Returns
    -------
    dict of float
        Largest displacement [mm] by the name of the picture.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> design = SensorDesign()
    >>> design = replace(design, array=replace(design.array, rows=1, cols=2))
    >>> list(view(design, Path(mkdtemp()) / "pressed.vtm", pressure_mpa=2.0))
    ["2 MPa at the indenter's middle"]
    """
    from tripillar.terminal.progress import Bars
    from tripillar.viewer.showing import show_deformed
    from tripillar.viewer.sights import largest_mm, read_body

    shown = read_body(Path(body)) if isinstance(body, str | Path) else body or SensorDesign()
    pressures = (pressure_mpa,) if isinstance(pressure_mpa, int | float) else tuple(pressure_mpa)
    target = None if save is None else Path(save)
    panels, _ = show_deformed(shown, target, pressures, load, colour, scale, camera, Bars(quiet=True))
    return {name: max(largest_mm(part.displacement_mm) for part in parts.values()) for name, parts in panels.items()}


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
