# SPDX-License-Identifier: MIT
"""The rendered site: ``ENTER_SITE=1 docker/enter python3 -m demos.site``."""
