# SPDX-License-Identifier: MIT
"""Variational mechanics in FEniCSx: energies, their derivatives and solves; bodies with names.

``from variform import forms, meshes``; both are imported when they are named.
"""

from importlib.util import find_spec

__all__ = ["forms", "meshes"]

if missing := [name for name in ("mpi4py", "petsc4py", "dolfinx") if find_spec(name) is None]:
    raise ImportError(
        f"variform needs {', '.join(missing)}, which this Python has not: in the folder of "
        "variform type docker/enter before the command, as docker/enter python3 -m demos.twist, or "
        "install DOLFINx 0.9 to 0.11."
    )
