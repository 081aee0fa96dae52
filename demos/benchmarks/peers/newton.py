# SPDX-License-Identifier: MIT
"""Newton's method for the codes that assemble and leave the rest to their user.

NumPy and SciPy; PARDISO by pypardiso where the code's environment has it.
"""

import time

import numpy as np
from scipy.sparse.linalg import spsolve

from .problem import STEPS

MOST = 30


def linear(name, clock):
    """Direct solver ``x = solve(A, b)``, timed: PARDISO for unsymmetric matrices, or SuperLU."""
    if name == "pardiso":
        from pypardiso import spsolve as chosen
    else:
        chosen = spsolve

    def solve(A, b):
        with clock("linear"):
            return chosen(A.tocsr() if name == "pardiso" else A.tocsc(), b)

    return solve


def newton(residual, tangent, fixed, prescribed, size, given, clock, solve, tolerance):
    """Follow the load path: prescribed increments enter with the first linear system of a step.

    Args:
        residual: Residual (size,) of unknowns u, supports ignored.
        tangent: Sparse matrix (size, size) of unknowns u, supports ignored.
        fixed: Numbers of the prescribed unknowns.
        prescribed: Values of the prescribed unknowns at a load factor.
        size: Number of unknowns.
        given: Command line.
        clock: Times its parts.
        solve: Linear solver.
        tolerance: Absolute norm that the free part of the residual is to reach.

    Returns:
        Unknowns, iterations of each step, and the last norm.

    Raises:
        RuntimeError: a step does not converge.
    """
    u, iterations, norm = np.zeros(size), [], np.inf
    free = np.setdiff1d(np.arange(size), fixed)
    R = np.zeros(size)
    for step in range(1, given.steps + 1):
        jump = prescribed(step / STEPS) - u[fixed]
        for count in range(MOST):
            with clock("tangent"):
                K = tangent(u).tocsr()[free]
                right = -R[free] - K[:, fixed] @ jump
                K = K[:, free]
            change = solve(K, right)
            u = u.copy()
            u[free] += change
            u[fixed] += jump
            jump = np.zeros(len(fixed))
            with clock("residual"):
                R = residual(u)
            norm = float(np.linalg.norm(R[free]))
            if norm <= tolerance:
                iterations.append(count + 1)
                break
        else:
            raise RuntimeError(f"step {step}: |R| = {norm:.1e} after {MOST} iterations")
    return u, iterations, norm


def medians(times, **works):
    """Median CPU seconds of each piece of work, as the columns of an assembly row."""
    seconds = {name: [] for name in works}
    for _ in range(times):
        for name, work in works.items():
            start = time.process_time()
            work()
            seconds[name].append(time.process_time() - start)
    return {f"{name}, once [s]": float(np.median(t)) for name, t in seconds.items()}
