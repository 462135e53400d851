"""``python -m studies layouts``: what layouts are worth, pad loads behind a converter and touch through plates."""

from dataclasses import replace
from typing import Annotated, Any

from cyclopts import Parameter

from dataset import DatasetSettings, simulate
from dataset.measurement import ReadingError
from decoupler import assess, train
from decoupler.readings import Pillars
from decoupler.touch.plates import PlateDecoder, plate_response
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import Array, Pad, SensorDesign, Unit
from geometry.layout import LAYOUTS
from studies.tables import OUT, Folder, Row, report
from studies.touched import assessed, unknown_samples

READ = ReadingError(noise=1e-3, bits=12)  #: of touches
TESTS = 200  #: samples of pad loads that test
KNOWN_SEED, UNKNOWN_SEED = 5, 77  #: those of docs/decoder.md


def back_again(response: ArrayResponse, samples: int) -> dict[str, Any]:
    """Errors of pad loads that come back from their own readings behind 12 bits alone, beside the readings' limit."""
    asked = DatasetSettings(protocol="three-axis", samples=samples, seed=1, bits=12)
    learned, tested = (simulate(response, each) for each in (asked, replace(asked, samples=TESTS, seed=2)))
    found = assess(train(learned, response=response), tested, response).values()
    return {
        "fx / fy / fz [N]": [one.errors.rmse_n for one in found],
        "times the limit": [one.ratio for one in found],
    }


def layouts(
    names: Annotated[list[str] | None, Parameter(name="--layout", help="Layout; may be given again.")] = None,
    units: Annotated[int, Parameter(help="Units along x, and along y.")] = 6,
    samples: Annotated[int, Parameter(help="Samples that a decoder of pad loads learns from.")] = 5000,
    contacts: Annotated[int, Parameter(help="Contacts of known shapes, and as many of unknown ones.")] = 120,
    out: Folder = OUT,
) -> None:
    """Print errors of layouts on their own simulator's data: of pads and back, and of shapes on plates."""
    back, touch = list[Row](), list[Row]()
    for name in names or ("song2018", "six-pillar", "eight-pillar"):
        design = SensorDesign(unit=Unit(layout=LAYOUTS[name]), array=Array(rows=units, cols=units))
        plated = replace(design, pad=Pad(kind="stiff"))
        responses = {kind: array_response(one)[0] for kind, one in (("soft", design), ("stiff", plated))}
        back += [{"layout": name, "pads": kind} | back_again(each, samples) for kind, each in responses.items()]
        library, pillars = plate_response(plated)[0], Pillars.designed(plated)
        decoder = PlateDecoder(design=plated, errors=READ, library=library, pillars=pillars)
        asked = DatasetSettings(protocol="indent", samples=contacts, seed=KNOWN_SEED, noise=READ.noise, bits=READ.bits)
        unknown = unknown_samples(plated, READ, contacts, UNKNOWN_SEED)
        for shapes, data in (("known", simulate(responses["stiff"], asked)), ("unknown", unknown)):
            touch.append({"layout": name, "shapes": shapes} | assessed(decoder, data))
    about = {"units": f"{units} × {units}", "samples": samples, "contacts": contacts}
    tables = {"Pad loads and back, 12 bits alone": back, "Touch through plates, 0.1 % and 12 bits": touch}
    report(tables, out / "layouts.json", about)
