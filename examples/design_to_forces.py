"""From a design to forces: change the paper's sensor, solve it, make data, train a network, hold it to its limit.

``python examples/design_to_forces.py`` takes about ten seconds, less when the response is in the cache already.
"""

from dataclasses import replace

import tripillar as tp

# 1. A sensor of another shape: 3 × 3 units, closer together and flatter, under smaller pads.
paper = tp.SensorDesign()
design = replace(
    paper,
    unit=replace(paper.unit, span_mm=8.0, height_mm=8.0),
    array=replace(paper.array, rows=3, cols=3, pitch_mm=12.0),
    pad=replace(paper.pad, size_mm=10.0),
)

# 2. What 1 N on any pad, along x, y or z, does to every electrode.
response = tp.response(design)
print(f"response: estimated error {response.error_estimate:.1e}")

# 3. Loads of all three axes on every pad, and what a sensor with noise and a 12-bit converter reads under them.
training, test = (
    tp.dataset(response, "three-axis", samples, seed=seed, noise=0.001, bits=12)
    for samples, seed in ((1000, 1), (200, 2))
)

# 4. One network for all forces, which starts from the inverse of the response.
model = tp.train(training)
print(f"trained in {model.made_from['outcome']['iterations']} iterations")

# 5. Its errors on samples it never saw, beside the least that these readings allow, and the paper's eq. 8.
print("force   error   limit   ratio   each pillar alone")
for name, one in tp.evaluate(model, test).items():
    limit_n = one.limits.cramer_rao_n
    alone_n = one.baselines["eq. 8, each pillar alone"].rmse_n
    print(f"{name:5} {one.errors.rmse_n:5.2f} N {limit_n:5.2f} N  {one.ratio:6.3f}  {alone_n:10.1f} N")

# 6. Forces of a single scan, with the half-widths that hold 68 % of their errors.
scan = test.resistance_ohm[:1]  # (1, rows, cols, 3): pillars z, x, y [Ω]
found, half_width, applied = model.forces(scan)[0], model.half_widths(scan)[0][0], test.force_n[0]
middle = 1, 1, 2  # row, column, axis z
print(f"the middle pad: Fz {found[middle]:.1f} ± {half_width[middle]:.1f} N, applied {applied[middle]:.1f} N")
