"""Errors of decoders under drifts of the readings, those that know of them and others: ``python -m studies.drift``."""

from dataclasses import replace

import numpy as np

from dataset import DatasetSettings, Samples, simulate
from decoupler import Decoupler, train
from decoupler.data.columns import COMPONENTS, force_columns
from decoupler.inverse.sensor_model import SensorModel
from fem.array.response import ArrayResponse
from fem.array.solving import array_response
from geometry.design import Drifts, Electrics, SensorDesign
from geometry.layout import FloatArray

DRIFTS = Drifts(drift=0.005, drift_tilt=0.005, drift_pillar=0.002)
ALL = COMPONENTS["all"]
TRAINING, TESTS, SHIFTED = 2000, 1000, 200  #: numbers of samples
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


def told(model: Decoupler, resistance_ohm: FloatArray, force_n: FloatArray) -> str:
    """Errors of a model on readings, beside what it states."""
    w = net_weights(model.rows * model.cols)
    error_n = model.forces(resistance_ohm) - force_n
    net_n = (error_n.reshape(len(error_n), -1) @ w)[:, 0]
    deviation = np.sqrt(model.deviations(resistance_ohm, w)[1][:, 0, 0])
    units = [np.mean(np.abs(error_n) <= width) for width in model.half_widths(resistance_ohm)]
    consistency = model.consistency(resistance_ohm)
    assert consistency is not None
    flagged = np.mean(np.greater(*consistency))
    return (
        f"units within {units[0]:.1%}, {units[1]:.1%}, worst {np.abs(error_n).max():.0f} N; net Fz "
        f"{np.sqrt(np.mean(net_n**2)):.0f} N, stated {deviation.mean():.0f} N, within 95 %: "
        f"{np.mean(np.abs(net_n) <= 2.0 * deviation):.1%}; flagged {flagged:.1%}"
    )


def main() -> None:
    """Print both tables of docs/decoder.md, section Drift."""
    plain = array_response(SensorDesign())[0]
    stated = replace(plain, design=replace(plain.design, electrics=Electrics(**vars(DRIFTS))))
    for protocol in ("three-axis", "contact"):
        drifting = samples(stated, protocol, TESTS, 2, DRIFTS)
        models = {
            "data": train(samples(stated, protocol, TRAINING, 1, DRIFTS), response=stated),
            "design": train(samples(stated, protocol, TRAINING, 1), response=stated),
            "nothing": train(samples(plain, protocol, TRAINING, 1), response=plain),
        }
        for name, model in models.items():
            print(f"{protocol}, stated by {name}: {told(model, drifting.resistance_ohm, drifting.force_n)}")
        print(f"{protocol}, posterior: net Fz {posterior_deviation(plain, protocol, drifting):.0f} N")
        still = samples(plain, protocol, SHIFTED, 2)
        R = still.resistance_ohm
        rising = 1.0 + np.linspace(0.0, 0.02, R.shape[2])[None, None, :, None]
        shifted = {"+ 0.5 %": 1.005 * R, "+ 2 %": 1.02 * R, "+ 100 Ω": R + 100.0, "0 to 2 % along x": R * rising}
        for shift, ohms in shifted.items():
            for name in ("nothing", "design"):
                print(f"{protocol}, {shift}, stated by {name}: {told(models[name], ohms, still.force_n)}")


if __name__ == "__main__":
    main()
