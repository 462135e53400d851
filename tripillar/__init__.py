"""TriPillar: from the design of a three-axis tactile sensor to forces with error bars.

``import tripillar as tp`` gives the names below, in the order of the data; each is loaded when it is first used. Open
`tripillar/face/` for what they do. All else is reached through its package (`geometry`, `fem`, `dataset`,
`decoupler`, `hardware`) and may change.

Examples
--------
Two pads instead of 36, to be quick:

>>> from dataclasses import replace
>>> from pathlib import Path
>>> from tempfile import mkdtemp
>>> import tripillar as tp
>>> folder = Path(mkdtemp())
>>> design = tp.SensorDesign()  # the paper's
>>> design = replace(design, array=replace(design.array, rows=1, cols=2))
>>> tp.write(design, folder / "sensor.toml")
>>> tp.read_design(folder / "sensor.toml") == design
True

>>> samples = tp.dataset(tp.response(design), "contact-fz", 100, seed=1, noise=0.001)
>>> tp.write(samples, folder / "samples.nc")
>>> tp.read_samples(folder / "samples.nc").resistance_ohm.shape
(100, 1, 2, 3)
>>> tp.Samples(force_n=samples.force_n[:5], resistance_ohm=samples.resistance_ohm[:5]).design is None  # as you measured
True

>>> tp.write(tp.train(samples, hidden=4), folder / "model.safetensors")
>>> tp.read_model(folder / "model.safetensors").forces(samples.resistance_ohm).shape
(100, 1, 2, 1)

>>> sensor = tp.VirtualSensor(design, folder / "model.safetensors", noise=0.001)  # in torch, for simulators
>>> sensor.shape
(1, 2)

>>> try:
...     replace(design.array, rows=0)
... except tp.TriPillarError as error:
...     print(error)
rows=0 must be from 1 to 255; units along y.
>>> tp.__version__ >= "0.1"
True
"""

TYPE_CHECKING = False  # as of `typing`, which takes time to load: a program takes Ctrl-C over first
if TYPE_CHECKING:
    from common.errors import TriPillarError
    from dataset.samples import Samples
    from dataset.stored import read_samples
    from decoupler.model_file import read_model
    from geometry.design import SensorDesign
    from geometry.design_file import read_design
    from hardware.session import live
    from hardware.virtual.sensor import VirtualSensor
    from tripillar.face.boards import record, replay
    from tripillar.face.bodies import response, solve
    from tripillar.face.exporting import write
    from tripillar.face.identifying import calibrate, identify, plan_loads
    from tripillar.face.learning import evaluate, train
    from tripillar.face.samples import dataset
    from tripillar.face.simulating import board
    from tripillar.face.studying import sweep
    from tripillar.face.viewing import view

    __version__: str

__all__ = [
    "Samples",
    "SensorDesign",
    "TriPillarError",
    "VirtualSensor",
    "board",
    "calibrate",
    "dataset",
    "evaluate",
    "identify",
    "live",
    "plan_loads",
    "read_design",
    "read_model",
    "read_samples",
    "record",
    "replay",
    "response",
    "solve",
    "sweep",
    "train",
    "view",
    "write",
]


def __getattr__(name: str) -> object:
    """Load a name of the face when it is first used."""
    from importlib import metadata

    from common.lazy import lazily

    return metadata.version("tripillar") if name == "__version__" else lazily(__name__)(name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
