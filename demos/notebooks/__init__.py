# SPDX-License-Identifier: MIT
"""Nine notebooks, and the builder that executes them."""
