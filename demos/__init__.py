# SPDX-License-Identifier: MIT
"""Demos: ``docker/enter python3 -m demos.NAME``."""

import sys

# The peers are run by environments of their own, and started by any Python.
if not any(word.startswith("demos.benchmarks.peers") for word in sys.orig_argv):
    import variform  # noqa: F401  # says what to type where DOLFINx is missing
