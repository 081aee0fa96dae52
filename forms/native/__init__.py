# SPDX-License-Identifier: MIT
"""Compiled code: FFCx's through DOLFINx, and the C library of point kernels and insertion."""
