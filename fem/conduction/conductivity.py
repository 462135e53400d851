"""Conductivity of a deformed conductor, pulled back to the shape that it has at rest."""

from dataclasses import dataclass

import numpy as np

from geometry.errors import DesignError
from geometry.layout import FloatArray


@dataclass(frozen=True, kw_only=True)
class Piezoresistivity:
    """Change of an isotropic rubber's resistivity with strain, none by default.

    The resistivity tensor of the deformed rubber is ρ [1 + m₁₂ tr ε + (m₁₁ − m₁₂) ε] with the strain ε = (F Fᵀ − 1)/2:
    the two elastoresistance coefficients of an isotropic material (Mason and Thurston, J. Acoust. Soc. Am. 29 (1957)
    1096). At small strain a bar that stretches by e along the current and thins by e' changes its resistivity by
    m₁₁ e − 2 m₁₂ e' as a fraction.
    """

    along: float = 0.0  #: m₁₁, by strain along the current
    across: float = 0.0  #: m₁₂, by strain across it


def pulled_back(F: FloatArray, piezoresistivity: Piezoresistivity | None = None) -> FloatArray:
    """Conductivity in the coordinates at rest, as a fraction of that at rest.

    Parameters
    ----------
    F : array, shape (..., 3, 3)
        Deformation gradients ∂x/∂X.
    piezoresistivity : Piezoresistivity, optional

    Returns
    -------
    array, shape (..., 3, 3)
        J F⁻¹ F⁻ᵀ = J C⁻¹ with C = FᵀF; with piezoresistivity J [(1 + m₁₂ tr E) C + (m₁₁ − m₁₂) C E]⁻¹, E = (C − 1)/2.
        Symmetric.

    Raises
    ------
    DesignError
        If a deformation turns the rubber inside out, or strains it so far that its resistivity would not be above 0.

    Examples
    --------
    >>> np.diag(pulled_back(np.diag([2.0, 1.0, 1.0]))).tolist()
    [0.5, 2.0, 2.0]
    """
    J = np.linalg.det(F)
    if not np.all(J > 0):
        raise DesignError(f"a pillar is deformed inside out (J = {np.min(J):.3g}, must be above 0): lower the load.")
    C = F.swapaxes(-1, -2) @ F
    resistivity = C
    if piezoresistivity is not None and piezoresistivity != Piezoresistivity():
        along, across = piezoresistivity.along, piezoresistivity.across
        E = (C - np.eye(3)) / 2
        volumetric = np.trace(E, axis1=-2, axis2=-1)[..., None, None]
        resistivity = (1 + across * volumetric) * C + (along - across) * (C @ E)
        least = float(np.linalg.eigvalsh(resistivity).min(initial=np.inf))
        if not least > 0:
            raise DesignError(
                f"elastoresistance {along:g} along and {across:g} across leaves no resistivity above 0 at this strain: "
                "lower the load or the coefficients."
            )
    return J[..., None, None] * np.linalg.inv(resistivity)
