# SPDX-License-Identifier: MIT
"""variform: from an energy density in UFL to residual, tangent and solution by PETSc SNES."""

if __name__ == "forms":
    raise ImportError("the packages have one name: write `from variform import forms, meshes`.")

from . import (
    _together,
    by_hand,
    contact,
    dissipation,
    energies,
    kinematics,
    membranes,
    obstacles,
    operators,
    schemes,
    stress,
)
from . import validity as validity
from .compilation import compiled
from .condensation import plane_stress
from .coulomb import friction
from .evaluation import evaluate
from .fields import field
from .files.checkpoint import Checkpoint
from .files.pictures import picture
from .files.tables import summary
from .files.vtx import VTX
from .kinematics import (
    axisymmetric,
    circumference,
    deformation_gradient,
    plane_stress_incompressible,
)
from .loads import (
    body_force,
    dead_traction,
    follower_pressure,
    gravity,
    point_load,
    pressure_potential,
    spring,
)
from .measured import Displacements, Reaction
from .membranes import enclosed_volume, membrane_gradient
from .obstacles import obstacle
from .paths import NotConverged, Path
from .problems import Problem
from .programs import table
from .results import at, displacement_of, integral, resultant, smallest_volume_ratio, volume
from .solving import (
    Data,
    arc_length,
    control,
    fit,
    follow,
    frequencies,
    gradient,
    lowest_modes,
    negative_eigenvalues,
    settle,
    solve,
    transient,
    unload,
)
from .supports import (
    clamp,
    pin,
    prescribe,
    roller,
    rotate,
    translate,
)
from .surface_contact import touching
from .unknowns import (
    Role,
    displacement,
    displacement_pressure,
    load_factor,
    unknown,
)
from .variation import derivative, residual, tangent

_together.end_together()

__all__ = [  # in the order a user meets them
    "load_factor",
    "table",
    "displacement",
    "displacement_pressure",
    "unknown",
    "Role",
    "deformation_gradient",
    "axisymmetric",
    "circumference",
    "plane_stress",
    "plane_stress_incompressible",
    "membrane_gradient",
    "kinematics",
    "membranes",
    "energies",
    "operators",
    "stress",
    "evaluate",
    "gravity",
    "body_force",
    "point_load",
    "dead_traction",
    "follower_pressure",
    "pressure_potential",
    "enclosed_volume",
    "spring",
    "obstacle",
    "obstacles",
    "friction",
    "touching",
    "clamp",
    "roller",
    "translate",
    "rotate",
    "prescribe",
    "pin",
    "derivative",
    "residual",
    "tangent",
    "by_hand",
    "compiled",
    "Problem",
    "solve",
    "follow",
    "Checkpoint",
    "arc_length",
    "control",
    "transient",
    "dissipation",
    "schemes",
    "settle",
    "frequencies",
    "negative_eigenvalues",
    "lowest_modes",
    "gradient",
    "Reaction",
    "fit",
    "Data",
    "Displacements",
    "unload",
    "Path",
    "NotConverged",
    "resultant",
    "contact",
    "at",
    "field",
    "displacement_of",
    "integral",
    "volume",
    "smallest_volume_ratio",
    "VTX",
    "summary",
    "picture",
]

_MOVED = {
    **dict.fromkeys(by_hand.__all__, "by_hand"),
    **dict.fromkeys(
        (
            "almansi_strain",
            "deformed_fiber",
            "fiber_invariants",
            "green_strain",
            "invariants",
            "isochoric",
            "left_cauchy_green",
            "material_product",
            "right_cauchy_green",
            "spatial_product",
            "volume_ratio",
        ),
        "kinematics",
    ),
    **dict.fromkeys(
        (
            "area_vector",
            "incompressible_sheet",
            "membrane_invariants",
            "membrane_pressure",
            "orientation",
        ),
        "membranes",
    ),
    "Convergence": "paths",
    "Newton": "solving",
    "SingularValueEnergy": "operators",
    "Step": "paths",
    "Support": "supports",
}


def __getattr__(name: str) -> object:
    """Say where a name of earlier versions is now."""
    if name in ("System", "system"):
        raise AttributeError(f"forms.{name} is now forms.Problem.")
    if name in _MOVED:
        raise AttributeError(f"forms.{name} is now forms.{_MOVED[name]}.{name}.")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}.")
