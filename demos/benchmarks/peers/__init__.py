# SPDX-License-Identifier: MIT
"""The same block solved by variform, by DOLFINx as its tutorial does it, and by other codes."""
