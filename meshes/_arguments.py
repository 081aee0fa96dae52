# SPDX-License-Identifier: MIT
"""Checks of arguments that several functions share; local, and raised before any collective."""

__all__ = ["check_order", "check_positive"]


def check_positive(**values: float | None) -> None:
    """Raise ValueError for the first value that is neither None nor a positive finite number."""
    for name, value in values.items():
        if value is not None and not 0 < value < float("inf"):
            raise ValueError(f"{name} must be positive, got {name}={value}.")


def check_order(order: int) -> None:
    """Raise ValueError for an order of the geometry other than 1 and 2."""
    if order not in (1, 2):
        raise ValueError(f"the order of the geometry must be 1 or 2, got order={order}.")
