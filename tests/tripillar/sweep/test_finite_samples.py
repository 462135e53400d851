"""Groups of samples made by workers: kept as they come, taken up again, failed ones counted."""

from queue import SimpleQueue

import numpy as np
import pytest

from dataset import DatasetSettings
from dataset.finite_strain import GROUP, Group
from dataset.simulation import LoadError
from fem.array.response import ArrayResponse
from geometry.design import Array, Pad, SensorDesign
from geometry.errors import DesignError
from tripillar.sweep.finite_samples import (
    GroupJob,
    group_row,
    groups_folder,
    kept_groups,
    make_groups,
)
from tripillar.sweep.tasks import TaskRow, ThisProcess, failed_task_row
from tripillar.sweep.workers import open_workers

DESIGN = SensorDesign(array=Array(rows=1, cols=1, pitch_mm=20.0), pad=Pad(kind="stiff"))
#: stands in for a response: samples at finite strain need one to correct their grids
NOMINAL = ArrayResponse(
    design=DESIGN,
    influence_mm_per_n=np.full((1, 1, 2, 3, 1, 1, 3), 1e-3),
    residual=0.0,
    unknowns=1,
    seconds={},
    error_estimate=1e-3,
)


@pytest.fixture
def job(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIPILLAR_CACHE", str(tmp_path / "cache"))
    return GroupJob(response=NOMINAL, settings=DatasetSettings(protocol="light", samples=3 * GROUP))


class Here:
    """Workers that make a group when it is asked for; `lost` are the numbers of those that no worker survives."""

    count = 2

    def __init__(self, lost=(), refused=()):
        self.lost, self.refused, self.given = lost, refused, []
        self._done = SimpleQueue()

    def give(self, task, job):
        self.given.append(task.number)
        if task.number in self.lost:
            self._done.put(failed_task_row(task, RuntimeError("its worker ended by SIGKILL"), ", the last of 20"))
        elif task.number in self.refused:
            self._done.put(TaskRow(cache_key="", number=task.number, reason="raise the cap", refused=True))
        else:
            self._done.put(TaskRow(cache_key="", number=task.number, made=blank(task.number).as_plain()))

    def row(self, wait_s):
        return self._done.get()

    def state(self):
        return ""


def blank(number):
    whole = np.full(GROUP, number)
    shape = {"traction_mpa": (GROUP, 1, 3), "displacement_mm": (GROUP, 1, 2, 3), "resistance_ratio": (GROUP, 1, 3)}
    arrays = {name: np.full(size, number / 3) for name, size in shape.items()}
    return Group(
        **arrays, error_estimate=whole / 3, ratio_error=whole / 3, iterations=whole, redrawn=whole, unsolved=whole
    )


def test_lost_groups_are_told_and_the_others_taken_up_again(job):
    first = Here(lost=[1])
    with pytest.raises(DesignError, match=r"1 of 3 groups of samples failed, such as number 1: RuntimeError"):
        make_groups(job, first, [0, 1, 2], lambda group: None)
    found = kept_groups(job)
    assert sorted(found) == [0, 2]
    assert np.array_equal(found[2].displacement_mm, blank(2).displacement_mm)
    (groups_folder(job) / "0000002.json").write_text('{"traction_mpa": []}')  # damaged
    assert sorted(kept_groups(job)) == [0]
    done = []
    made = make_groups(job, Here(), [1, 2], done.append)
    assert sorted(made) == [1, 2]
    assert len(done) == 2
    assert sorted(kept_groups(job)) == [0, 1, 2]


def test_what_no_worker_can_do_ends_at_once(job):
    with pytest.raises(LoadError, match="raise the cap"):
        make_groups(job, Here(refused=[0]), [0, 1, 2], lambda group: None)


def test_a_process_makes_to_the_last_bit_what_this_one_does(job, tmp_path):
    with open_workers(1, None, tmp_path / "log", group_row, failed_task_row) as workers:
        made = make_groups(job, workers, [1], lambda group: None)
    here = make_groups(job, ThisProcess(group_row), [1], lambda group: None)
    for name, values in vars(here[1]).items():
        assert np.array_equal(getattr(made[1], name), values)
