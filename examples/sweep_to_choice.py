"""From a sweep to a choice: judge small arrays by their response alone, choose one, and see what a network makes of it.

``python examples/sweep_to_choice.py`` takes some 10 seconds, less when the responses are in the cache already. For more
designs than these use ``tripillar sweep FILE``, which shares the work among processes and goes on where it was stopped.
"""

import tripillar as tp
from geometry import design_from_toml
from tripillar.sweep.judge import row_of
from tripillar.sweep.sampling import samples_of
from tripillar.sweep.sweep_file import sweep_from_dict
from tripillar.sweep.trade_offs import ranked

NOISE, BITS = 0.001, 12  # of the readings

# 1. Eight 2 × 2 arrays: units how far apart, how tall, under pads how large? The sensor must fit on 11 cm², and carry
#    450 N a pad before a pillar is strained by 30 %.
sweep = sweep_from_dict({
    "design": {"array": {"rows": 2, "cols": 2}},
    "sweep": {"sampling": "sobol", "samples": 8, "seed": 1, "noise": NOISE, "bits": BITS},
    "vary": [
        {"key": "array.pitch_mm", "low": 13.0, "high": 20.0},
        {"key": "unit.height_mm", "low": 6.0, "high": 12.0},
        {"key": "pad.size_mm", "of": "array.pitch_mm", "low": 0.5, "high": 1.0},
    ],
    "bounds": {"area_cm2": {"most": 11.0}, "range_n": {"least": 450.0}},
})  # fmt: skip

# 2. The metrics of each design, from its finite-element response: nothing is trained for them.
rows = [row_of(sample, sweep.judging) for sample in samples_of(sweep)]

# 3. Those within the bounds, the least noise-limited error first.
best = ranked(rows, sweep)
print(f"{len(best)} of {len(rows)} designs are small and strong enough:")
print("pitch  height   pad    error   range   crosstalk")
for row in best:
    pitch_mm, height_mm, pad_mm = row.values.values()
    error_n, range_n, talk = (row.metrics[name] for name in ("error_n", "range_n", "crosstalk_1"))
    print(f"{pitch_mm:5.1f} {height_mm:6.1f} {pad_mm:6.1f} mm {error_n:5.2f} N {range_n:5.0f} N   {talk:5.2f}")

# 4. The choice, trained on loads of a few indenters. It learns what loads are usual, and so may pass the limit of the
#    readings alone.
design = design_from_toml(best[0].design)
training, test = (
    tp.dataset(design, "contact", samples, seed=seed, noise=NOISE, bits=BITS) for samples, seed in ((1000, 1), (200, 2))
)
model = tp.train(training)
for name, one in tp.evaluate(model, test).items():
    print(f"{name}: error {one.errors.rmse_n:.2f} N, {one.ratio:.3f} times the limit of the readings")
