# SPDX-License-Identifier: MIT
"""Who proposes the next state of a path: load steps, targets of a functional, arc length."""
