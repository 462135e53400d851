"""From the options of `tripillar view --serve` to a page in the browser."""

import json
from contextlib import ExitStack
from importlib.util import find_spec
from typing import TYPE_CHECKING

from geometry.design import SensorDesign
from geometry.errors import DesignError, FileFormatError
from geometry.storage.files import digest
from tripillar.terminal.console import say
from tripillar.viewer.page.address import require_free
from tripillar.viewer.page.options import PageOptions

if TYPE_CHECKING:
    from decoupler.model.decoupler import Decoupler
    from tripillar.terminal.progress import Bars

NEEDED = ("aiohttp",)


def open_page(options: PageOptions, design: SensorDesign | None, bars: "Bars", as_json: bool = False) -> None:
    """Serve the page until Ctrl-C; its address is printed on stdout once browsers can come.

    `design` None is the model's, if there is a model that knows it, else the paper's.

    Raises
    ------
    TriPillarError, OSError
        If a package is missing, if the page's port is taken, and as reading the files and opening the sensor's port do.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise DesignError(f"the page needs {', '.join(missing)}, not installed: pip install 'tripillar[page]'.")
    require_free(options.host, options.http_port)
    from decoupler.model.model_file import read_model
    from fem.fields.array_field import array_field
    from tripillar.pipeline.run import respond
    from tripillar.viewer.page.feed import SensorFeed, SensorWatch
    from tripillar.viewer.page.page import Subject
    from tripillar.viewer.page.sensing import ForceSource, InverseForces, NetForces, SensorModel
    from tripillar.viewer.page.serving import serve
    from tripillar.viewer.page.superposition import Superposition

    model = None if options.model is None else read_model(options.model)
    if model is not None:
        design = _design_for(model, str(options.model), design)
    with ExitStack() as stack:
        watch = None
        if options.port is not None and model is not None:
            watch = SensorWatch(stack.enter_context(SensorFeed(options.port, model, options.calibration)))
        with bars:
            _, response = respond(design or SensorDesign(), bars)
            advance = bars.begin("page", total=2)
            field = array_field(response.design, lambda step: advance(0, step))
            advance(1, "decoupler")
            source: ForceSource
            source = InverseForces(response) if model is None else NetForces(model, f"the model {options.model}")
            subject = Subject(loads=Superposition(field), sensor=SensorModel(response), source=source, watch=watch)
            advance(1, "")

        def tell(url: str) -> None:
            print(json.dumps({"url": url}) if as_json else url, flush=True)
            say("" if as_json else "Ctrl-C ends it")

        serve(subject, options.host, options.http_port, tell)


def _design_for(model: "Decoupler", name: str, given: SensorDesign | None) -> SensorDesign:
    """The given design, else the model's, else the paper's; of as many units as the model's.

    Raises
    ------
    FileFormatError
        If it is of an array of another size.
    """
    design = given or model.design or SensorDesign()
    rows, cols = design.array.rows, design.array.cols
    if (model.rows, model.cols) != (rows, cols):
        raise FileFormatError(
            f"{name} is of {model.rows} × {model.cols} units, the design has {rows} × {cols}: give its --design."
        )
    if model.design_hash not in (None, digest(design)):
        say("warning: the model was trained for another design: its forces are those of that design")
    return design
