# SPDX-License-Identifier: MIT
"""Cases with a known answer, run by one command: numbers, errors and pictures."""
