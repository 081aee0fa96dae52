# SPDX-License-Identifier: MIT
"""Tables and pictures of the README files that follow from the code, and their registries."""
