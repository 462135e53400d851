"""From a sweep to a choice: judge small arrays by their response alone, choose one, and see what a network makes of it.

``python examples/sweep_to_choice.py`` takes some 15 seconds, less when the responses are in the cache already.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import tripillar as tp
from geometry import design_from_toml

NOISE, BITS = 0.001, 12  # of the readings

# 1. Eight 2 × 2 arrays: units how far apart, how tall, under pads how large? The sensor must fit on 11 cm², and carry
#    450 N a pad before a pillar is strained by 30 %.
SWEEP = f"""
design = {{ array = {{ rows = 2, cols = 2 }} }}
sweep = {{ sampling = "sobol", samples = 8, seed = 1, noise = {NOISE}, bits = {BITS} }}
bounds = {{ area_cm2 = {{ most = 11.0 }}, range_n = {{ least = 450.0 }} }}
vary = [
    {{ key = "array.pitch_mm", low = 13.0, high = 20.0 }},
    {{ key = "unit.height_mm", low = 6.0, high = 12.0 }},
    {{ key = "pad.size_mm", of = "array.pitch_mm", low = 0.5, high = 1.0 }},
]
"""


def main() -> None:
    """Judge, choose, train."""
    # 2. The metrics of each design, from its finite-element response: nothing is trained for them. The best comes
    #    first.
    with TemporaryDirectory() as folder:
        file = Path(folder) / "small.toml"
        file.write_text(SWEEP)
        rows = tp.sweep(file, out=folder)
    print("pitch  height   pad    error   range   area")
    for row in rows:
        pitch_mm, height_mm, pad_mm = row.values.values()
        error_n, range_n, area_cm2 = (row.metrics[name] for name in ("error_n", "range_n", "area_cm2"))
        size = f"{pitch_mm:5.1f} {height_mm:6.1f} {pad_mm:6.1f} mm"
        print(f"{size} {error_n:5.2f} N {range_n:5.0f} N {area_cm2:5.1f} cm²")

    # 3. The choice, trained on loads of a few indenters. It learns what loads are usual, and so may pass the limit of
    #    the readings alone.
    design = design_from_toml(rows[0].design)
    training, test = (
        tp.dataset(design, "contact", samples, seed=seed, noise=NOISE, bits=BITS)
        for samples, seed in ((1000, 1), (200, 2))
    )
    model = tp.train(training)
    for name, one in tp.evaluate(model, test).items():
        print(f"{name}: error {one.errors.rmse_n:.2f} N, {one.ratio:.3f} times the limit of the readings")


if __name__ == "__main__":  # designs are judged by processes that import this
    main()
