# SPDX-License-Identifier: MIT
"""Linear solvers: presets, preconditioners and how long each is kept."""
