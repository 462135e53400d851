"""``python -m studies drift``: errors of decoders under drifts, of those that know of them and others."""

from dataclasses import replace
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from dataset import DatasetSettings, Samples, simulate
from decoupler import Decoupler, train
from decoupler.data.columns import COMPONENTS, force_columns
from decoupler.inverse.sensor_model import SensorModel
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import Drifts, Electrics, SensorDesign
from geometry.layout import FloatArray
from studies.tables import OUT, Folder, Row, report

DRIFTS = Drifts(drift=0.005, drift_tilt=0.005, drift_pillar=0.002)
ALL = COMPONENTS["all"]
PROTOCOLS = ("three-axis", "contact")
SHIFTED = 200  #: samples
LOADS = 20_000  #: for the covariance of usual loads


def samples(response: ArrayResponse, protocol: str, n: int, seed: int, drifts: Drifts | None = None) -> Samples:
    """Samples read with noise of 0.1 % through 12 bits."""
    own = vars(drifts or Drifts())
    asked = DatasetSettings(protocol=protocol, samples=n, seed=seed, noise=1e-3, bits=12, **own)
    return simulate(response, asked).labels()


def net_weights(n_units: int) -> FloatArray:
    """Weights of all forces in the net Fz, (3·n_units, 1)."""
    return np.tile([[0.0], [0.0], [1.0]], (n_units, 1))


def posterior_deviation(response: ArrayResponse, protocol: str, data: Samples) -> float:
    """Root mean square deviation of the net Fz [N] of the linear-Gaussian posterior about each load.

    C − C Jᵀ (J C Jᵀ + Σ)⁻¹ J C, C the covariance of the protocol's loads.
    """
    forward, w = SensorModel.of(response, ALL), net_weights(response.design.n_units)
    C = np.cov(force_columns(samples(response, protocol, LOADS, 3).force_n, ALL).T)
    variance = []
    for force_n in force_columns(data.force_n, ALL)[:SHIFTED, None]:
        length, J = forward.jacobian(force_n)
        ohm = forward.ohm_per_mm2 * length**2
        J = (2.0 * ohm / length)[0, :, None] * J[0]
        U = data.errors.shared(ohm, *data.shape)[0]
        S = J @ C @ J.T + np.diag(data.errors.deviation(ohm)[0] ** 2) + U @ U.T
        JCw = J @ C @ w
        variance.append((w.T @ C @ w - JCw.T @ np.linalg.solve(S, JCw)).item())
    return float(np.sqrt(np.mean(variance)))


def judged(model: Decoupler, resistance_ohm: FloatArray, force_n: FloatArray) -> Row:
    """Errors of a model on readings, beside what it states."""
    w = net_weights(model.rows * model.cols)
    error_n = model.forces(resistance_ohm) - force_n
    net_n = (error_n.reshape(len(error_n), -1) @ w)[:, 0]
    deviation = np.sqrt(model.deviations(resistance_ohm, w)[1][:, 0, 0])
    within = [100.0 * float(np.mean(np.abs(error_n) <= width)) for width in model.half_widths(resistance_ohm)]
    consistency = model.consistency(resistance_ohm)
    assert consistency is not None
    return {
        "units within 68 / 95 % [%]": within,
        "worst [N]": float(np.abs(error_n).max()),
        "net Fz [N]": float(np.sqrt(np.mean(net_n**2))),
        "stated [N]": float(deviation.mean()),
        "net within 95 % [%]": 100.0 * float(np.mean(np.abs(net_n) <= 2.0 * deviation)),
        "flagged [%]": 100.0 * float(np.mean(np.greater(*consistency))),
    }


def rows_of(plain: ArrayResponse, protocol: str, train_samples: int, test_samples: int) -> tuple[list[Row], list[Row]]:
    """Rows under drifts that are stated by the data, the design or nothing, and under shifts of all readings."""
    stated = replace(plain, design=replace(plain.design, electrics=Electrics(**vars(DRIFTS))))
    drifting, named = samples(stated, protocol, test_samples, 2, DRIFTS), {"protocol": protocol}
    models = {
        "data": train(samples(stated, protocol, train_samples, 1, DRIFTS), response=stated),
        "design": train(samples(stated, protocol, train_samples, 1), response=stated),
        "nothing": train(samples(plain, protocol, train_samples, 1), response=plain),
    }
    drifted: list[Row] = [
        named | {"drift stated by": name} | judged(model, drifting.resistance_ohm, drifting.force_n)
        for name, model in models.items()
    ]
    least = {"drift stated by": "linear posterior", "net Fz [N]": posterior_deviation(plain, protocol, drifting)}
    still = samples(plain, protocol, SHIFTED, 2)
    R = still.resistance_ohm
    rising = 1.0 + np.linspace(0.0, 0.02, R.shape[2])[None, None, :, None]
    shifts = {"+ 0.5 %": 1.005 * R, "+ 2 %": 1.02 * R, "+ 100 Ω": R + 100.0, "0 to 2 % along x": R * rising}
    shifted = [
        named | {"shift": shift, "drift stated by": name} | judged(models[name], ohms, still.force_n)
        for shift, ohms in shifts.items()
        for name in ("nothing", "design")
    ]
    return [*drifted, named | least], shifted


def drift(
    out: Folder = OUT,
    samples: Annotated[int, Parameter(help="Training samples.")] = 2000,
    tests: Annotated[int, Parameter(help="Test samples.")] = 1000,
) -> None:
    """Judge decoders under drift, as docs/decoder.md tells."""
    response = array_response(SensorDesign())[0]
    drifted, shifted = zip(*(rows_of(response, protocol, samples, tests) for protocol in PROTOCOLS), strict=True)
    tables = {"Under drifts of 0.5 %, 0.5 % tilted, 0.2 % a pillar": drifted, "Under a shift of all readings": shifted}
    report({title: [row for rows in each for row in rows] for title, each in tables.items()}, out / "drift.json")
