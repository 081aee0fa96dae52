# SPDX-License-Identifier: MIT
"""Files: checkpoints, VTX, tables, pictures; all collective, on any number of ranks."""
