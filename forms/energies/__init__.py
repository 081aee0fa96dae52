# SPDX-License-Identifier: MIT
"""Energy densities: functions of a 3x3 deformation gradient that return psi [J/m^3]."""

from .active import active_tension
from .invariants import (
    isochoric_neo_hookean,
    isotropic,
    mooney_rivlin,
    neo_hookean,
    neo_hookean_quadratic,
    saint_venant_kirchhoff,
    stable_neo_hookean,
    volumetric,
    yeoh,
)
from .membrane import mooney_rivlin_sheet, neo_hookean_sheet, saint_venant_kirchhoff_sheet, sheet
from .mixed import with_pressure
from .moduli import bulk_modulus, lame_from_shear, lame_from_young
from .muscle import activated
from .stretches import (
    as_rigid_as_possible,
    corotated_linear,
    extended,
    fixed_corotated,
    hencky,
    neo_hookean_stretches,
    ogden,
    principal,
    saint_venant_kirchhoff_stretches,
    stable_neo_hookean_stretches,
    symmetric_dirichlet,
)
from .transversely_isotropic import (
    guccione,
    transversely_isotropic_constants,
    transversely_isotropic_constants_five,
    transversely_isotropic_neo_hookean,
)
from .wrinkling import (
    neo_hookean_tension_field,
    saint_venant_kirchhoff_tension_field,
    tension_field,
)

__all__ = [
    "activated",
    "active_tension",
    "as_rigid_as_possible",
    "bulk_modulus",
    "corotated_linear",
    "extended",
    "fixed_corotated",
    "guccione",
    "hencky",
    "isochoric_neo_hookean",
    "isotropic",
    "lame_from_shear",
    "lame_from_young",
    "mooney_rivlin",
    "mooney_rivlin_sheet",
    "neo_hookean",
    "neo_hookean_quadratic",
    "neo_hookean_sheet",
    "neo_hookean_stretches",
    "neo_hookean_tension_field",
    "ogden",
    "principal",
    "saint_venant_kirchhoff",
    "saint_venant_kirchhoff_sheet",
    "saint_venant_kirchhoff_stretches",
    "saint_venant_kirchhoff_tension_field",
    "sheet",
    "stable_neo_hookean",
    "stable_neo_hookean_stretches",
    "symmetric_dirichlet",
    "tension_field",
    "transversely_isotropic_constants",
    "transversely_isotropic_constants_five",
    "transversely_isotropic_neo_hookean",
    "volumetric",
    "with_pressure",
    "yeoh",
]
