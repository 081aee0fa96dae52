# SPDX-License-Identifier: MIT
"""The ways of Newton's method on forms/solving/README.md: the ladder, word by word."""

from variform.forms.solving.ladder import LADDER, Failure, Merit

FAILURES = {
    Failure.LINEAR: "a linear solver that failed",
    Failure.USED_UP: "iterations that were used up",
    Failure.NO_DESCENT: "a search without descent",
    Failure.CREEPING: "a search by |R| that creeps",
    Failure.NOT_FINITE: "a state that is not finite",
    Failure.NEAR: "a search by the energy that has come near the solution",
}


def lines():
    """A line for each way: what it is, and after which failures it is tried."""
    rows = []
    for number, way in enumerate(LADDER, start=1):
        after = [FAILURES[failure] for failure in Failure if failure in way.on]
        where = {Merit.ENERGY: " of a search by the energy", Merit.NONE: " of full steps"}.get(
            way.after, ""
        )
        rows.append(f"{number}. {way.words}; after {' or '.join(after)}{where}")
    return rows
