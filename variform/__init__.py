# SPDX-License-Identifier: MIT
"""Variational mechanics in FEniCSx: energies, their derivatives and solves; bodies with names.

``from variform import forms, meshes``; both are imported when they are named.
"""

__all__ = ["forms", "meshes"]
