"""Parts that every exported form of a `Decoupler` needs: weights in newtons, facts about it."""

from importlib.metadata import PackageNotFoundError, version

from common.errors import TriPillarError
from decoupler.model.decoupler import Decoupler
from geometry.layout import FloatArray


class ExportError(TriPillarError, RuntimeError):
    """A model that cannot be exported."""


def output_weights_n(decoupler: Decoupler) -> FloatArray:
    """Output weights that give newtons without unscaling, (n_out, n_hidden [+ n_in] + 1) [N], bias last."""
    weights = decoupler.network.output * decoupler.output_scaling.half_range[:, None]
    weights[:, -1] += decoupler.output_scaling.centre
    return weights


def facts(decoupler: Decoupler) -> dict[str, str]:
    """Facts about the model for a reader of the exported file, by name."""
    made_from, network, pillars = decoupler.made_from, decoupler.form, ", ".join(decoupler.layout.pillar_names)
    try:
        program = version("tripillar")
    except PackageNotFoundError:
        program = "unknown"
    return {
        "component": decoupler.component.name,
        "axes": " ".join(decoupler.component.forces),
        "net": f"{network.net}, {network.hidden} hidden nodes",
        "feature": network.feature,
        "units": f"resistance_ohm in ohm (pillars {pillars}), force_n in newton (fz positive in compression)",
        "design_hash": decoupler.design_hash or "unknown",
        "data_hash": str(made_from.get("data_hash", "unknown")),
        "model_hash": str(made_from.get("recipe", "unknown")),
        "version": program,
    }
