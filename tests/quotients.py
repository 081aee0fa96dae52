# SPDX-License-Identifier: MIT
"""Central differences of a problem's energy and residual, against residual and tangent."""

import numpy as np


def rates(problem, v, steps):
    """Rates at which differences along v come to R . v and v . K v, over steps that halve."""
    u = problem.u
    start, b, A = u.x.array.copy(), problem.create_vector(), problem.create_matrix()
    problem.residual(b)
    problem.tangent(A)
    x = b.duplicate()
    x.array[:] = v
    slope, curvature, first, second = b.dot(x), x.dot(A * x), [], []
    for h in steps:
        energies, slopes = [], []
        for sign in (1, -1):
            u.x.array[:] = start + sign * h * v
            energies.append(problem.energy())
            problem.residual(b)
            slopes.append(b.dot(x))
        first.append(abs((energies[0] - energies[1]) / (2 * h) - slope))
        second.append(abs((slopes[0] - slopes[1]) / (2 * h) - curvature))
    turns = len(steps) - 1
    return [np.log2(errors[0] / errors[-1]) / turns for errors in (first, second)]
