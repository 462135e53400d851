"""The paper's experiments, small."""

from studies.paper.experiments import Experiments

SMALL = Experiments(
    widths=(1, 2, 3),
    training_samples=100,
    test_samples=20,
    folds=2,
    table_nodes={"fz": 2, "fx": 3},
    shown_nodes=3,
    shown_samples=5,
)
