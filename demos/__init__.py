# SPDX-License-Identifier: MIT
"""Demos: ``docker/enter python3 -m demos.NAME``."""

import variform  # noqa: F401  # says what to type where DOLFINx is missing
