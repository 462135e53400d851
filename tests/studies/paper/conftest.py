"""Results of the paper's experiments, small, on four units in closed form: trained once for all tests."""

from pathlib import Path

import pytest

from fem.array.response import ArrayResponse
from fem.array.solving import ResponseSettings, array_response
from geometry.design import Array, SensorDesign
from studies.paper.__main__ import results_for
from studies.paper.results import Results
from tests.studies.paper.small_experiments import SMALL
from tripillar.terminal.progress import Bars


@pytest.fixture(scope="session")
def response(tmp_path_factory: pytest.TempPathFactory) -> ArrayResponse:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRIPILLAR_CACHE", str(tmp_path_factory.mktemp("cache")))
        return array_response(SensorDesign(array=Array(rows=2, cols=2)), ResponseSettings(method="layer"))[0]


@pytest.fixture(scope="session")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("paper") / "results.json"


@pytest.fixture(scope="session")
def results(response: ArrayResponse, stored: Path) -> Results:
    with Bars(quiet=True) as bars:
        return results_for(response, SMALL, stored, bars)
