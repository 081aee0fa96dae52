# SPDX-License-Identifier: MIT
"""Measurements: each module prints JSON rows and writes a table and a chart."""
